"""Loads the network of an exported folder as a function of one frame: x [Dx], phase [] or [G] -> y [Dy].

x and y are in the column order and the units that `layout` of description.json states, whatever the format.
"""

from pathlib import Path

import numpy as np


def load_network(folder, description, style=0):
    """Returns the function (x, phase) -> y of one exported style.

    Args:
        folder: as `pfnn-jax export` wrote it. ONNX needs onnxruntime, StableHLO needs JAX.
        description: its description.json.
        style: number of the style in the description.
    """
    kinds = {"bins": _from_bins, "onnx": _from_onnx, "stablehlo": _from_stablehlo}
    return kinds[description["format"]](Path(folder), description, style)


def _from_onnx(folder, description, style):
    import onnxruntime

    session = onnxruntime.InferenceSession(folder / description["network"]["file"], providers=["CPUExecutionProvider"])
    return _single_rows(lambda rows: session.run(["y"], rows)[0], folder, description, style)


def _from_stablehlo(folder, description, style):
    import jax

    program = jax.export.deserialize(bytearray((folder / description["network"]["file"]).read_bytes()))
    return _single_rows(lambda rows: program.call(*rows.values()), folder, description, style)


def _single_rows(run, folder, description, style):
    """Turns a function of batches, by name of input, into a function of one frame."""
    more = {}
    if any(entry["name"] == "style" for entry in description["network"]["inputs"]):  # a FiLM network takes its style
        more["style"] = np.fromfile(folder / description["styles"][style]["file"], "<f4")[None]

    def evaluate(x, phase):
        rows = {"x": np.array(x, np.float32)[None], "phase": np.array(phase, np.float32)[None]}
        return np.asarray(run(rows | more))[0].astype(float)

    return evaluate


def _from_bins(folder, description, style):
    def read(name, rows=1):
        return np.fromfile(folder / f"{name}.bin", "<f4").astype(np.float64).reshape(rows, -1)

    net, own = description["network"], description["styles"][style]["files"] if description["styles"] else {}
    stats = {name: read(file)[0] for name, file in net["statistics"].items()}
    layers, mixing = [], np.array(net["mixing"])  # from the stored matrices to control points or experts
    for files in net["layers"]:
        biases = np.concatenate([read(b) for b in files["biases"]])
        weights = np.stack([read(w, biases.shape[1]) for w in files["weights"]])
        layers.append((np.tensordot(mixing, weights, 1), mixing @ biases))
    gates = [(read(w, read(b).size), read(b)[0]) for w, b in net["gating"]]
    film = [(read(scale)[0], read(shift)[0]) for scale, shift in own.get("film", ())]
    if "cp" in own:  # residual A diag(D) B h + bias on the second layer; only D depends on the phase
        a, b, bias = (read(name, rows) for name, rows in own["cp"])
        d = mixing @ np.concatenate([read(name) for name in own["cp_diagonal"]])

    def gate(v):  # a small network of the local phases, whose outputs choose the experts
        for n, (weights, biases) in enumerate(gates):
            v = weights @ (elu(v) if n else v) + biases
        return v

    def evaluate(x, phase):
        c = softmax(gate((phase - stats["phase_mean"]) / stats["phase_std"])) if gates else spline(phase)
        h = (x - stats["x_mean"]) / stats["x_std"]
        for n, (weights, biases) in enumerate(layers):
            f = np.tensordot(c, weights, 1) @ h + c @ biases
            if n == 1 and "cp" in own:
                f = f + a @ ((c @ d) * (b @ h)) + bias[0]
            if n < 2 and film:  # layer norm, then the style's scale and shift
                f = film[n][0] * (f - f.mean()) / np.sqrt(f.var() + 1e-8) + film[n][1]
            h = elu(f) if n < 2 else f
        return h * stats["y_std"] + stats["y_mean"]

    return evaluate


def elu(v):
    """Returns the activation of every hidden layer."""
    return np.where(v > 0, v, np.expm1(np.minimum(v, 0)))


def softmax(v):
    """Returns shares that sum to 1."""
    v = np.exp(v - v.max())
    return v / v.sum()


def spline(phase):
    """Returns the cyclic Catmull-Rom coefficients [4] of the control points at phases 0, pi/2, pi, 3pi/2."""
    k, d, c = int(phase * 2 // np.pi), phase * 2 / np.pi % 1, np.zeros(4)
    c[(k + np.arange(-1, 3)) % 4] = 2 * d**2 - d - d**3, 2 - 5 * d**2 + 3 * d**3, d + 4 * d**2 - 3 * d**3, d**3 - d**2
    return c / 2
