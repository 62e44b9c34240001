"""A character for an engine: it follows commands, holds its feet, and ends in local rotations of a rig."""

import json
from pathlib import Path

import numpy as np

from .body import Body
from .foot_lock import FootLocks
from .ground import mix, to_world, turn_towards
from .loop import NOW, PublishedLoop
from .network import load_network
from .rotations import about, about_vertical, conjugate, from_axes, from_half_angles, mix_rotations, multiply, rotate
from .standing import Standing, at_height, ground, middle, smooth
from .tracking import Tracking


def load(folder, style: int | str = 0, evaluate=None):
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
        self.body = Body(info["skeleton"], k["legs"], k["arms"], k["chest"])
        self.locks = FootLocks(k["foot_lock"], self.body, k["leg_length"])
        self.loop = PublishedLoop(info, evaluate)
        self.progress, self.previous = 1.0, {}
        self.next = self._warm_up(speeds["tracked_speed"])
        distance = self._feet_distance(self.next["joints"])
        self.tracking = Tracking(k["tracking"], self.speed, speeds["tracked_speed"] / self.speed, distance)
        self.previous = self.next
        self._carry(facing, position)
        self.loop.velocity, self.loop.facing = self.speed * facing, facing
        centre = position - complex(speeds["stance"]["hips"][1], speeds["stance"]["hips"][0]) * facing
        self.standing = Standing(k["standing"], speeds["stance"], k["leg_length"], self.speed, centre, facing)
        self.root, self.facing, self.contacts = position, facing, np.ones(4)
        local = self.body.local_rotations(self.next["rotations"])
        self._set_pose(self.next["joints"][0], local, facing, self.standing.feet, np.ones(2))

    def step(self, velocity, direction):
        """Advances one drawn frame under a command: velocity in m/s, and facing; both z + ix.

        At 0 m/s it stops, and turns on the spot to the facing.
        """
        if self.standing.stopped:
            self._follow_body(self.tracking.moving(velocity))
        self.tracking.update_time_scale(velocity)
        self.progress += self.tracking.time_scale
        while self.progress > 1.0:
            self._next_network_frame(velocity, direction)
            self.progress -= 1.0
        self._draw(velocity, direction)

    def _warm_up(self, speed):
        """Walks unseen from the mean pose into the gait of the style; returns the frame with the feet passing."""
        found = []
        for frame in range(sum(self.constants["warm_up_frames"])):
            faced = self.loop.directions[NOW]
            out = self._network_step(speed, 1.0)
            if frame >= self.constants["warm_up_frames"][0]:
                distance = self._feet_distance(self.loop.pose["joint_position"])
                found.append((distance, frame, self.loop.snapshot(), self._frame(out, faced)))
        _, _, state, self.next = min(found, key=lambda each: each[:2])
        self.previous = self.next
        self.loop.restore(state)
        turned = np.conj(self.next["facing"])
        self._carry(turned, -self.next["root"] * turned)
        return self.next

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
        distance, stands = self._feet_distance(loop.pose["joint_position"]), self.standing.weight >= 1.0
        tracking.update(loop.positions[NOW] - root, facing, velocity, direction, distance, stands)
        angle = tracking.heading_correction(velocity)
        loop.rotate(angle, self._standing_point(out))
        self.previous, self.next = self.next, self._frame(out, facing * np.exp(1j * angle))

    def _carry(self, turned, shift):
        """Rotates what the network has predicted about the origin by a unit number, then shifts it by a point."""
        self.loop.carry(turned, shift)
        self.locks.carry(turned, shift)
        self.previous, self.next = (
            frame
            | {
                "root": frame["root"] * turned + shift,
                "facing": frame["facing"] * turned,
                "joints": to_world(frame["joints"], turned, shift),
                "rotations": multiply(about_vertical(turned), frame["rotations"]),
            }
            for frame in (self.previous, self.next)
        )

    def _follow_body(self, moving):
        """Carries the network's motion to where the standing body has come to: by the root, or, to walk off, a foot."""
        before, after, share = self.previous, self.next, self.progress
        place, target = mix(before["root"], after["root"], share), self.root
        turned = self.standing.facing / turn_towards(before["facing"], after["facing"], share)
        if moving:  # the foot on which the network stands
            feet = mix(before["joints"], after["joints"], share)[self.body.feet].reshape(2, 2, 3)
            lower = np.argmin(feet[..., 1].mean(1))
            place, target = middle(feet)[lower], middle(self.standing.feet)[lower]
        self._carry(turned, target - place * turned)

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

    def _standing_point(self, out):
        """Returns the point about which a turn does not slide the foot that stands; the root if none does."""
        contacts = self._predicted_contacts(out).reshape(2, 2).mean(1)
        if contacts.max() <= self.constants["tracking"]["standing_contact"]:
            return self.loop.positions[NOW]
        feet = middle(self.loop.pose["joint_position"][self.body.feet].reshape(2, 2, 3))
        return feet[contacts == contacts.max()].mean()

    def _feet_distance(self, joints):
        """Returns the metres on the ground between the middles of both feet."""
        left, right = middle(joints[self.body.feet].reshape(2, 2, 3))
        return abs(right - left)

    def _draw(self, velocity, direction):
        """Sets what is drawn: between two predicted frames on rigid bones, or in the stance of the style."""
        before, after, progress, body = self.previous, self.next, self.progress, self.body
        predicted, contacts = (mix(before[name], after[name], progress) for name in ("joints", "contacts"))
        hips = predicted[0]
        local = body.local_rotations(mix_rotations(before["rotations"], after["rotations"], progress))
        feet, shares, drop = self.locks.plan(body.forward_kinematics(hips, local)[0], contacts)
        hips, local = hips - [0.0, drop, 0.0], body.reach_arms(hips, local, predicted)
        facing, standing = turn_towards(before["facing"], after["facing"], progress), self.standing
        walk = {"hips": ground(hips), "facing": facing, "feet": feet, "contacts": contacts.reshape(2, 2)}
        standing.update(walk, self.tracking.moving(velocity), direction)
        self.root, self.facing, self.contacts = mix(before["root"], after["root"], progress), facing, contacts
        if standing.weight > 0.0:
            stands, turned = smooth(standing.weight), standing.facing / facing
            self.root = standing.hips + (1.0 - stands) * (self.root - walk["hips"]) * turned
            self.facing, self.contacts = standing.facing, mix(contacts, standing.contacts(), stands)
        self._set_pose(hips, local, facing, feet, shares)

    def _set_pose(self, hips, local, facing, feet, shares):
        """Sets the drawn pose, with its feet placed: that of the walk, or between it and the stance.

        Args:
            hips, local, facing: of the body as the network has it.
            feet, shares: [2, 2, 3] and [2], where its heels and toes go, and how far toes decide.
        """
        standing, body = self.standing, self.body
        if standing.weight > 0.0:
            hips, local = self._blend(hips, local, facing)
        positions, world = body.forward_kinematics(hips, local)
        if standing.weight > 0.0:
            drop = np.array([0.0, self.locks.needed_drop(positions, standing.feet.reshape(4, 3)), 0.0])
            hips, positions, shares = hips - drop, positions - drop, np.ones(2)
            feet = [body.lift_heel(leg, positions, foot) for leg, foot in zip(body.legs, standing.feet, strict=True)]
        local = local.copy()
        for leg, foot, share in zip(body.legs, feet, shares, strict=True):
            body.place_leg(leg, local, world, positions, foot, share)
        self.hips, self.local_rotations = hips, local
        self.joints, self.rotations = body.forward_kinematics(hips, local)

    def _blend(self, hips, local, facing):
        """Returns hips and local rotations between the walk and the stance, which breathes and sways."""
        standing, chest, share = self.standing, self.body.chest, smooth(self.standing.weight)
        walked = local.copy()
        walked[0] = multiply(about_vertical(np.conj(facing)), local[0])
        local = mix_rotations(walked, standing.rotations, share)
        shift, pitch = standing.sway()
        if chest is not None:  # about the axis that points to the left in the stance
            left = rotate(conjugate(standing.chest), np.array([1.0, 0.0, 0.0]))
            local[chest] = multiply(local[chest], about(left, pitch))
        local[0] = multiply(about_vertical(standing.facing), local[0])
        height = mix(hips[1], standing.height, share)
        return at_height(standing.hips + shift * 1j * standing.facing, height), local
