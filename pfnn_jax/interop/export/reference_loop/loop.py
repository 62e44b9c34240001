"""The published loop of Holden 2017, Mason 2018, 2022: a command bends the trajectory, the output moves a body.

In layouts `mason2018` and `pfnn2017` y describes this frame's joints and the root's velocity; in those of `mason2022`
(`next_frame`) it describes the next frame, whose root is the first trajectory sample.
"""

import numpy as np

from .ground import fill, mix, to_local, to_world, turn_towards, unit

NOW = 60  # index of the present among the 111 trajectory points, frames -60 to +50


class PublishedLoop:
    """One character in the loop of the published demos.

    Attributes:
        positions, directions: [111] complex: the trajectory on the ground and the facings, one point a frame.
        gait: [111, 6] weights of stand, walk, jog, crouch, jump, bump.
        pose: blocks of joints [J, 3] in the world: joint_position, joint_velocity and what else the layout has.
        phase: radians, or the gating input [G].
        velocity, facing: the smoothed command.
    """

    def __init__(self, description, evaluate):
        self.layout, self.constants, self.evaluate = description["layout"], description["loop"], evaluate
        self.fps, self.late = self.layout["fps"], self.layout["next_frame"]
        self.start(np.array(description["start"]["x"]), np.array(description["start"]["phase"], float))

    def start(self, x, phase):
        """Takes up the motion that a row of inputs describes, at the origin, facing +Z."""
        blocks = self.read(x, "inputs")
        self.positions, self.directions = fill(blocks["position"]), unit(fill(blocks["direction"]))
        self.gait, self.phase = fill(blocks["gait"]), phase
        self.velocity, self.facing = (self.positions[110] - self.positions[NOW]) * self.fps / 50, self.directions[NOW]
        self.pose = self.place(blocks, self.joint_point)

    def snapshot(self):
        """Returns the state of the character, for `restore`."""
        names = ("positions", "directions", "gait", "pose", "phase", "velocity", "facing")
        return {name: getattr(self, name).copy() if name in names[:4] else getattr(self, name) for name in names}

    def restore(self, state):
        """Takes up a state that `snapshot` returned."""
        self.__dict__.update(state)

    @property
    def joint_point(self):
        """Returns the trajectory point that joints of x are relative to: now, or the frame before."""
        return NOW if self.late else NOW - 1

    def read(self, values, side="outputs"):
        """Returns the blocks of x or y in metres, seconds and radians: joints [J, 3], trajectory complex [samples]."""
        blocks = {name: values[b["columns"]] * b["scale"] for name, b in self.layout[side].items()}
        blocks |= {name: v.reshape(-1, 3) for name, v in blocks.items() if name.startswith("joint_")}
        blocks |= {k: blocks[f"trajectory_{k}_z"] + 1j * blocks[f"trajectory_{k}_x"] for k in ("position", "direction")}
        if "joint_up" in blocks:
            forward, up = unit(blocks["joint_forward"]), blocks["joint_up"]
            blocks |= {"joint_forward": forward, "joint_up": unit(up - (up * forward).sum(-1, keepdims=True) * forward)}
        return blocks | {"gait": np.reshape(blocks.get("gait", np.repeat([0, 1, 0, 0, 0, 0], 12)), (6, 12)).T}  # walk

    def place(self, blocks, point):
        """Returns the joints of a frame in the world, from those relative to a trajectory point."""
        facing = self.directions[point]
        pose = {name: to_world(v, facing) for name, v in blocks.items() if name.startswith("joint_")}
        return pose | {"joint_position": to_world(blocks["joint_position"], facing, self.positions[point])}

    def step(self, velocity, direction):
        """Advances one frame under a command (velocity in m/s, facing; both z + ix). Returns the blocks of y."""
        self.steer(velocity, direction)
        out = self.read(self.evaluate(self.network_input(), self.phase))
        self.advance(out)
        return out

    def steer(self, velocity, direction):
        """Blends the future trajectory, the later the more, towards the command."""
        k, ahead = self.constants, np.arange(1, 51) / 60
        self.velocity = mix(self.velocity, k["command_gain"] * velocity, k["velocity_rate"])
        self.facing = turn_towards(self.facing, direction, k["direction_rate"])
        steps = mix(np.diff(self.positions[NOW:]), self.velocity / self.fps, 1 - (1 - ahead) ** k["position_bias"])
        self.positions[NOW + 1 :] = self.positions[NOW] + np.cumsum(steps)
        share = 1 - (1 - ahead) ** k["direction_bias"]
        self.directions[NOW + 1 :] = turn_towards(self.directions[NOW + 1 :], self.facing, share)
        moving, jog = min(abs(self.velocity) / k["stand_speed"], 1), abs(self.velocity) >= k["jog_speed"]
        wanted = [1 - moving, moving * (1 - jog), moving * jog, 0, 0, 0]
        self.gait[NOW:] = mix(self.gait[NOW], wanted, k["gait_rate"])

    def network_input(self):
        """Returns x [Dx]: the trajectory relative to this root, the joints relative to this or the previous root."""
        here, facing = self.positions[NOW], self.directions[NOW]
        before, faced = self.positions[self.joint_point], self.directions[self.joint_point]
        blocks = {name: to_local(v, faced) for name, v in self.pose.items()} | {"gait": self.gait[::10].T}
        blocks["joint_position"] = to_local(self.pose["joint_position"], faced, before)
        for n, v in ("position", (self.positions[::10] - here) / facing), ("direction", self.directions[::10] / facing):
            blocks |= {f"trajectory_{n}_x": v.imag, f"trajectory_{n}_z": v.real}
        x = np.zeros(self.layout["input_size"])  # the ground is flat: terrain heights stay 0
        for name in blocks.keys() & self.layout["inputs"].keys():
            x[self.layout["inputs"][name]["columns"]] = blocks[name].ravel() / self.layout["inputs"][name]["scale"]
        return x

    def advance(self, out):
        """Moves the body, the root, the trajectory and the phase to the next frame by the blocks of y."""
        pose = self.place(out, NOW)
        moved = self.pose["joint_position"] + (pose if self.late else self.pose)["joint_velocity"] / self.fps
        self.pose = pose | {"joint_position": mix(moved, pose["joint_position"], self.constants["pose_rate"])}
        positions, directions = self._next_frames(out) if self.late else self._moved_root(out)
        self.positions = np.append(self.positions[1 : NOW + 1], positions)
        self.directions = np.append(self.directions[1 : NOW + 1], unit(directions))
        self.gait = np.concatenate([self.gait[1 : NOW + 1], self.gait[NOW:]])
        if self.layout["phase_kind"] == "velocity":  # the gate reads the velocities of hands and feet
            ends = self.pose["joint_velocity"][self.layout["end_effectors"]]
            self.phase = to_local(ends, self.directions[NOW]).ravel()

    def _moved_root(self, out):
        """Returns the next root, moved by its predicted velocity, and the predicted future; advances the phase."""
        rate = max(1 - self.gait[NOW, 0], 0) ** 0.25 / self.fps  # no drift while standing
        here, facing = self.positions[NOW], self.directions[NOW]
        here = here + rate * facing * (out["root_velocity"] @ [1j, 1])
        facing = facing * np.exp(1j * rate * out["root_yaw_rate"][0])
        self.phase = (self.phase + (0.9 * rate + 0.1 / self.fps) * out["phase_change"][0]) % (2 * np.pi)
        positions, directions = fill(out["position"])[1:], fill(out["direction"])[1:]
        return here + facing * np.append(0, positions), facing * np.append(1, directions)

    def _next_frames(self, out):
        """Returns the predicted trajectory mixed with the one that it replaces; its first point is the next root."""
        here, facing, rate = self.positions[NOW], self.directions[NOW], self.constants["trajectory_rate"]
        if self.layout["phase_kind"] == "local":
            moved = self.phase + out["local_phase_change"]
            self.phase = mix(moved, out["local_phase"], self.constants["phase_rate"])
        elif self.layout["phase_kind"] == "global":
            self.phase = (self.phase + out["phase_change"][0] / self.fps) % (2 * np.pi)
        positions = mix(self.positions[NOW::10], here + out["position"] * facing, rate)
        return fill(positions), fill(turn_towards(self.directions[NOW::10], out["direction"] * facing, rate))

    def rotate(self, angle, centre):
        """Rotates the character and its trajectory about a point by an angle in radians; its command stays."""
        turned = np.exp(1j * angle)
        self._move(turned, centre - centre * turned)

    def carry(self, turned, shift):
        """Rotates the character with its command about the origin by a unit number, then shifts it by a point."""
        self._move(turned, shift)
        self.velocity, self.facing = self.velocity * turned, self.facing * turned

    def _move(self, turned, shift):
        self.positions, self.directions = self.positions * turned + shift, self.directions * turned
        pose = {name: to_world(v, turned) for name, v in self.pose.items()}
        self.pose = pose | {"joint_position": to_world(self.pose["joint_position"], turned, shift)}

    def limit_lookahead(self, speed):
        """Limits the speed of the future trajectory to one in m/s."""
        steps, longest = np.diff(self.positions[NOW:]), speed / self.fps
        self.positions[NOW + 1 :] = self.positions[NOW] + np.cumsum(steps * (longest / np.maximum(abs(steps), longest)))
