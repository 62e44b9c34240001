"""Reference loop for engines, in NumPy alone, on a folder written by `pfnn-jax export RUN --format bins`.

Metres, seconds, radians, 60 frames per second; Y up, +Z forward, +X left. Ground points are complex numbers z + ix: a
facing is e^(i yaw), a rotation is a product. In `mason2018` and `pfnn2017` y describes this frame's joints and the root
velocity; in `mason2022` (`next_frame`) it describes the next frame, whose root is the first trajectory sample.
"""

import json
from pathlib import Path

import numpy as np


def mix(old, new, share):
    return old + share * (new - old)


def unit(v):
    return v / (np.abs(v) if np.iscomplexobj(v) else np.linalg.norm(v, axis=-1, keepdims=True))


def turn_towards(facing, target, share):
    return facing * np.exp(1j * share * np.angle(target / facing))


def turn(v, facing, point: complex | np.ndarray = 0j):
    """Rotates vectors [J, 3] from the frame of a root into the world, then translates them on the ground."""
    ground = (v[:, 2] + 1j * v[:, 0]) * facing + point
    return np.stack([ground.imag, v[:, 1], ground.real], -1)


def fill(samples):
    """Interpolates samples [M, ...] that are ten frames apart linearly: [10 (M - 1) + 1, ...]."""
    last, at = samples[-1:], np.arange(10).reshape(1, -1, *[1] * (samples.ndim - 1)) / 10
    return np.concatenate([mix(samples[:-1, None], samples[1:, None], at).reshape(-1, *last.shape[1:]), last])


def spline(phase):
    """Returns the cyclic Catmull-Rom coefficients [4] of the control points at phases 0, π/2, π, 3π/2."""
    k, d, c = int(phase * 2 // np.pi), phase * 2 / np.pi % 1, np.zeros(4)
    c[(k + np.arange(-1, 3)) % 4] = 2 * d**2 - d - d**3, 2 - 5 * d**2 + 3 * d**3, d + 4 * d**2 - 3 * d**3, d**3 - d**2
    return c / 2


def load_network(folder, description, style=0):
    """Returns a function of x [Dx] and phase [] or [8] -> y [Dy], in the units of the layout."""

    def read(name, rows=1):
        return np.fromfile(Path(folder) / f"{name}.bin", "<f4").astype(np.float64).reshape(rows, -1)

    net, own = description["network"], description["styles"][style]["files"] if description["styles"] else {}
    stats = {name: read(file)[0] for name, file in net["statistics"].items()}
    layers, mixing = [], np.array(net["mixing"])  # from tables to control points (pfnn), or the identity (lpn)
    for files in net["layers"]:
        biases = np.concatenate([read(b) for b in files["biases"]])
        weights = np.stack([read(w, biases.shape[1]) for w in files["weights"]])
        layers.append((np.tensordot(mixing, weights, 1), mixing @ biases))
    gates = [(read(w, read(b).size), read(b)[0]) for w, b in net["gating"]]
    film = [(read(scale)[0], read(shift)[0]) for scale, shift in own.get("film", ())]
    if "cp" in own:  # residual A diag(D) B h + bias on the second layer; only D depends on the phase
        a, b, bias = (read(name, rows) for name, rows in own["cp"])
        d = mixing @ np.concatenate([read(name) for name in own["cp_diagonal"]])

    def evaluate(x, phase):
        if gates:
            v = gates[0][0] @ ((phase - stats["phase_mean"]) / stats["phase_std"]) + gates[0][1]
            for w, shift in gates[1:]:
                v = w @ np.where(v > 0, v, np.expm1(np.minimum(v, 0))) + shift
            v = np.exp(v - v.max())
        c, h = v / v.sum() if gates else spline(phase), (x - stats["x_mean"]) / stats["x_std"]
        for n, (weights, biases) in enumerate(layers):
            f = np.tensordot(c, weights, 1) @ h + c @ biases
            if n == 1 and "cp" in own:
                f = f + a @ ((c @ d) * (b @ h)) + bias[0]
            if n < 2 and film:  # layer norm, then the style's scale and shift
                f = film[n][0] * (f - f.mean()) / np.sqrt(f.var() + 1e-8) + film[n][1]
            h = np.where(f > 0, f, np.expm1(np.minimum(f, 0))) if n < 2 else f
        return h * stats["y_std"] + stats["y_mean"]

    return evaluate


class Character:
    """Character state: 111 trajectory points (frames -60 to +50; index 60 is now), joints in the world, phase."""

    def __init__(self, folder, style: int | str = 0):
        info = json.loads((Path(folder) / "description.json").read_text(encoding="utf-8"))
        numbers = {key: n for n, entry in enumerate(info["styles"] or [{"name": 0}]) for key in (n, entry["name"])}
        if info["format"] != "bins" or style not in numbers:
            raise ValueError(f"{folder}: {info['format']}, style {style!r}; must be bins, one of styles {[*numbers]}")
        self.layout, self.k, self.evaluate = info["layout"], info["loop"], load_network(folder, info, numbers[style])
        self.late, self.phase = self.layout["next_frame"], np.array(info["start"]["phase"])
        self.asked_speed = (info["styles"] or [info["start"]])[numbers[style]]["asked_speed"]  # m/s, for a walk
        x = self.read(np.array(info["start"]["x"]), "inputs")
        self.positions, self.directions, self.gait = fill(x["position"]), unit(fill(x["direction"])), fill(x["gait"])
        self.velocity, self.facing = (self.positions[110] - self.positions[60]) * 60 / 50, self.directions[60]
        self.pose = self.to_world(x, 60 if self.late else 59)

    def read(self, values, side="outputs"):
        """Returns the blocks of x or y in metres, seconds and radians: joints [J, 3], trajectory complex [samples]."""
        blocks = {name: values[b["columns"]] * b["scale"] for name, b in self.layout[side].items()}
        blocks |= {name: v.reshape(-1, 3) for name, v in blocks.items() if name.startswith("joint_")}
        blocks |= {k: blocks[f"trajectory_{k}_z"] + 1j * blocks[f"trajectory_{k}_x"] for k in ("position", "direction")}
        if "joint_up" in blocks:
            forward, up = unit(blocks["joint_forward"]), blocks["joint_up"]
            blocks |= {"joint_forward": forward, "joint_up": unit(up - (up * forward).sum(-1, keepdims=True) * forward)}
        return blocks | {"gait": np.reshape(blocks.get("gait", np.repeat([0, 1, 0, 0, 0, 0], 12)), (6, 12)).T}  # walk

    def to_world(self, blocks, point):
        pose = {name: turn(v, self.directions[point]) for name, v in blocks.items() if name.startswith("joint_")}
        return pose | {"joint_position": turn(blocks["joint_position"], self.directions[point], self.positions[point])}

    def step(self, velocity, direction):
        """Advances one frame under a command (velocity in m/s, facing; both z + ix). Returns the blocks of y."""
        k, here, facing, ahead = self.k, self.positions[60], self.directions[60], np.arange(1, 51) / 60
        self.velocity = mix(self.velocity, k["command_gain"] * velocity, k["velocity_rate"])  # 1. steer the future
        self.facing = turn_towards(self.facing, direction, k["direction_rate"])
        steps = mix(np.diff(self.positions[60:]), self.velocity / 60, 1 - (1 - ahead) ** k["position_bias"])
        self.positions[61:] = here + np.cumsum(steps)
        self.directions[61:] = turn_towards(self.directions[61:], self.facing, 1 - (1 - ahead) ** k["direction_bias"])
        moving, jog = min(abs(self.velocity) / k["stand_speed"], 1), abs(self.velocity) >= k["jog_speed"]
        self.gait[60:] = mix(self.gait[60], [1 - moving, moving * (1 - jog), moving * jog, 0, 0, 0], k["gait_rate"])
        # 2. Network input: the trajectory relative to this root, the joints relative to this or the previous root.
        before, faced = (v[60 if self.late else 59] for v in (self.positions, self.directions))
        blocks = {name: turn(v, faced.conj()) for name, v in self.pose.items()} | {"gait": self.gait[::10].T}
        blocks["joint_position"] = turn(self.pose["joint_position"], faced.conj(), -before * faced.conj())
        for n, v in ("position", (self.positions[::10] - here) / facing), ("direction", self.directions[::10] / facing):
            blocks |= {f"trajectory_{n}_x": v.imag, f"trajectory_{n}_z": v.real}
        x = np.zeros(self.layout["input_size"])  # the ground is flat: terrain heights stay 0
        for name in blocks.keys() & self.layout["inputs"].keys():
            x[self.layout["inputs"][name]["columns"]] = blocks[name].ravel() / self.layout["inputs"][name]["scale"]
        out = self.read(self.evaluate(x, self.phase))  # 3. evaluate; 4. advance body, root, trajectory and phase
        pose = self.to_world(out, 60)
        moved = self.pose["joint_position"] + (pose if self.late else self.pose)["joint_velocity"] / 60
        self.pose = pose | {"joint_position": mix(moved, pose["joint_position"], k["pose_rate"])}
        if self.late:
            positions = fill(mix(self.positions[60::10], here + out["position"] * facing, k["trajectory_rate"]))
            directions = fill(turn_towards(self.directions[60::10], out["direction"] * facing, k["trajectory_rate"]))
            self.phase = mix(self.phase + out["local_phase_change"], out["local_phase"], k["phase_rate"])
        else:
            rate = max(1 - self.gait[60, 0], 0) ** 0.25 / 60  # no drift while standing
            here = here + rate * facing * (out["root_velocity"] @ [1j, 1])
            facing = facing * np.exp(1j * rate * out["root_yaw_rate"][0])
            positions = here + facing * np.append(0, fill(out["position"])[1:])
            directions = facing * np.append(1, fill(out["direction"])[1:])
            self.phase = (self.phase + (0.9 * rate + 0.1 / 60) * out["phase_change"][0]) % (2 * np.pi)
        self.positions = np.append(self.positions[1:61], positions)
        self.directions = np.append(self.directions[1:61], unit(directions))
        self.gait = np.concatenate([self.gait[1:61], self.gait[60:]])
        return out
