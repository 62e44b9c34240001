"""A character for an engine: it follows commands, holds its feet, and ends in local rotations of a rig."""

import json
from pathlib import Path

import numpy as np

from .body import Body
from .foot_lock import FootLocks
from .ground import mix, turn_towards
from .loop import NOW, PublishedLoop
from .network import load_network
from .rotations import about_vertical, from_axes, from_half_angles, mix_rotations, multiply
from .tracking import Tracking


def load(folder, style=0, evaluate=None):
    """Returns the description of an export, its network as a function of one frame, and the speeds of a style.

    Args:
        folder: as `pfnn-jax export` wrote it, in any format.
        style: name or number of an exported style.
        evaluate: a function (x [Dx], phase) -> y [Dy] in the units of the description, if another runtime evaluates the
            network.
    """
    info = json.loads((Path(folder) / "description.json").read_text(encoding="utf-8"))
    numbers = {key: n for n, entry in enumerate(info["styles"] or [{"name": 0}]) for key in (n, entry["name"])}
    if style not in numbers:
        raise ValueError(f"{folder}: style {style!r}; must be one of {[*numbers]}")
    number = numbers[style]
    speeds = info["styles"][number] if info["styles"] else info["start"]
    return info, evaluate or load_network(folder, info, number), speeds


class Character:
    """One character of an export.

    Attributes:
        hips: [3] metres, position of joint 0.
        local_rotations: [J, 4] wxyz: of each joint in its parent's frame, which is what a rig takes.
        joints, rotations: [J, 3] metres and [J, 4], all joints in the world.
        root, facing: complex z + ix, on the ground.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        speed: m/s at which the style walks by nature.
    """

    def __init__(self, folder, style=0, evaluate=None, position=0j, facing=1 + 0j):
        info, evaluate, speeds = load(folder, style, evaluate)
        if info["controller"] is None:
            raise ValueError(f"{folder}: controller: none; the skeleton needs a humanoid map with legs")
        k, self.speed = info["controller"], speeds["speed"]
        self.constants, self.foot_heights = k, np.array(k["foot_heights"])
        self.body = Body(info["skeleton"], k["legs"], k["arms"])
        self.locks = FootLocks(k["foot_lock"], self.body, k["leg_length"])
        self.loop = PublishedLoop(info, evaluate)
        self.progress, self.previous = 1.0, {}
        self.next = self._warm_up(speeds["tracked_speed"], position, facing)
        clearance = self._clearance(self.next["joints"])
        self.previous = self.next
        self.tracking = Tracking(k["tracking"], self.speed, speeds["tracked_speed"] / self.speed, clearance)
        self._pose()

    def step(self, velocity, direction):
        """Advances one drawn frame under a command: velocity in m/s, and facing; both z + ix. 0 m/s means stop."""
        self.tracking.update_time_scale(velocity)
        self.progress += self.tracking.time_scale
        while self.progress > 1.0:
            self._next_network_frame(velocity, direction)
            self.progress -= 1.0
        self._pose()

    def _warm_up(self, speed, position, facing):
        """Walks unseen from the mean pose into the gait of the style; returns the frame with the lowest feet."""
        loop, count = self.loop, self.constants["warm_up_frames"]
        if "gait" in loop.layout["inputs"]:  # the network has been trained on standing, too
            loop.stand()
            speed = 0.0
        found = []
        for frame in range(count):
            faced = loop.directions[NOW]
            out = self._network_step(speed, 1.0)
            if frame >= count // 2:
                heights = loop.pose["joint_position"][self.body.feet, 1] - self.foot_heights
                found.append((heights.max(), frame, loop.snapshot(), out, faced))
        _, _, state, out, faced = min(found, key=lambda each: each[:2])
        loop.restore(state)
        turned = facing / loop.directions[NOW]
        loop.place_at(position, facing)
        loop.velocity, loop.facing = self.speed * facing, facing
        return self._frame(out, faced * turned)

    def _network_step(self, velocity, direction):
        self.loop.limit_lookahead(self.constants["tracking"]["max_lookahead_ratio"] * self.speed)
        return self.loop.step(velocity, direction)

    def _next_network_frame(self, velocity, direction):
        loop, tracking = self.loop, self.tracking
        root, facing = loop.positions[NOW], loop.directions[NOW]
        command = loop.velocity / loop.constants["command_gain"], loop.facing  # to stop, it goes on as it does
        if tracking.moving(velocity):
            command = tracking.network_command(velocity, direction, facing)
        out = self._network_step(*command)
        clearance = self._clearance(loop.pose["joint_position"])
        tracking.update(loop.positions[NOW] - root, facing, velocity, direction, clearance)
        angle = tracking.heading_correction(velocity)
        loop.rotate(angle)
        self.previous, self.next = self.next, self._frame(out, facing * np.exp(1j * angle))

    def _frame(self, out, facing):
        """Returns a predicted frame in the world; `facing` is that of the root that y is relative to."""
        loop = self.loop
        if "joint_rotation" in out:
            rotations = from_half_angles(out["joint_rotation"])
        else:
            rotations = from_axes(out["joint_forward"], out["joint_up"])
        return {
            "root": loop.positions[loop.joint_point],
            "facing": loop.directions[loop.joint_point],
            "joints": loop.pose["joint_position"],
            "rotations": multiply(about_vertical(facing), rotations),
            "contacts": self._predicted_contacts(out),
        }

    def _predicted_contacts(self, out):
        """Returns contacts [4]: an output of the network, or else by the height and speed of the feet."""
        if "contacts" in out:
            return np.clip(out["contacts"], 0.0, 1.0)
        if "foot_contacts" in out:  # right, left
            return np.clip(out["foot_contacts"], 0.0, 1.0)[[1, 1, 0, 0]]
        k, pose, feet = self.constants, self.loop.pose, self.body.feet
        speed = np.linalg.norm(pose["joint_velocity"][feet], axis=-1) / k["contact_speed"]
        height = (pose["joint_position"][feet, 1] - self.foot_heights) / k["contact_height"]
        return np.clip(1.5 - np.maximum(speed, height), 0.0, 1.0)

    def _clearance(self, joints):
        """Returns the height in metres of the higher foot, by the lower of its heel and toe."""
        return (joints[self.body.feet, 1] - self.foot_heights).reshape(2, 2).min(1).max()

    def _pose(self):
        """Sets what is drawn: between two predicted frames, on rigid bones, with the feet held."""
        before, after, share = self.previous, self.next, self.progress
        predicted, contacts = (mix(before[name], after[name], share) for name in ("joints", "contacts"))
        world = mix_rotations(before["rotations"], after["rotations"], share)
        hips, local = predicted[0], self.body.local_rotations(world)
        local = self.body.reach_arms(hips, local, predicted)
        standing = self.tracking.time_scale == 0.0  # feet that are held then stay held
        kept = np.where(standing & self.locks.held, 1.0, contacts)
        self.hips, self.local_rotations = self.locks.apply(hips, local, kept)
        self.joints, self.rotations = self.body.forward_kinematics(self.hips, self.local_rotations)
        self.root, self.contacts = mix(before["root"], after["root"], share), contacts
        self.facing = turn_towards(before["facing"], after["facing"], share)
