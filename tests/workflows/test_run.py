"""Laws of the run directory: it rebuilds itself, styles travel, whatever does not fit is refused in one sentence."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.io import checkpoint
from pfnn_jax.models.config import AdapterConfig, AdapterKind, GeneratorConfig, NetworkConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json
from pfnn_jax.run import (
    create_run,
    load_generator,
    load_run,
    load_style,
    load_train_state,
    save_generator,
    save_shared,
    save_style,
    save_train_state,
)
from pfnn_jax.run_config import RunConfig, list_styles, load_config, style_note, train_step
from pfnn_jax.training.log import append_metrics, read_metrics, rewind_metrics
from tests.raising import assert_refused

HIDDEN, JOINTS = 6, 3
LAYOUT = mason2018(JOINTS)
SKELETON = Skeleton(
    names=("Hips", "Left", "Right"),
    parents=np.array([-1, 0, 0]),
    offsets=np.array([[0, 0.9, 0], [0.1, 0, 0], [-0.1, 0, 0]]),
    end_sites=((1, np.array([0, 0, 0.2])),),
    mirror=np.array([0, 2, 1]),
)
NORMALISER = Normaliser(
    Statistics(np.full(LAYOUT.input_size, 0.5, np.float32), np.full(LAYOUT.input_size, 2.0, np.float32)),
    Statistics(np.full(LAYOUT.output_size, 0.1, np.float32), np.full(LAYOUT.output_size, 3.0, np.float32)),
)


def make_config(**changes):
    settings = {
        "network": NetworkConfig(input_size=LAYOUT.input_size, output_size=LAYOUT.output_size, hidden=HIDDEN),
        "adapter": AdapterConfig(rank=2),
        "layout": "mason2018",
        "num_joints": JOINTS,
        "styles": ("angry", "old"),
        "skeleton": skeleton_to_json(SKELETON),
        "pretrain": {"learning_rate": 1e-4, "steps": 10},
    }
    return RunConfig(**{**settings, **changes})


def make_adapter(kind: AdapterKind = "cp", rank=2, seed=1, hidden=HIDDEN):
    return init_style(
        AdapterConfig(kind, rank),
        NetworkConfig(LAYOUT.input_size, LAYOUT.output_size, hidden),
        key=jax.random.key(seed),
    )


def make_run(path, seed=0, **changes):
    config = make_config(**changes)
    create_run(path, config, NORMALISER)
    save_shared(path, init_network(config.network, key=jax.random.key(seed)))
    return path


def assert_equal(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_a_run_rebuilds_itself(tmp_path):
    run = load_run(make_run(tmp_path / "run", seed=3), layout="mason2018")
    assert run.config == make_config()
    assert run.layout == LAYOUT
    assert run.skeleton.names == SKELETON.names
    np.testing.assert_array_equal(run.skeleton.offsets, SKELETON.offsets)
    np.testing.assert_array_equal(run.normaliser.outputs.std, NORMALISER.outputs.std)
    assert_equal(run.shared, init_network(run.config.network, key=jax.random.key(3)))
    assert set(run.config.versions) == {"pfnn_jax", "jax"}


def test_a_run_of_low_rank_networks_rebuilds_itself(tmp_path):
    network = dataclasses.replace(make_config().network, rank=3)
    run = load_run(make_run(tmp_path / "run", network=network))
    assert_equal(run.shared, init_network(network, key=jax.random.key(0)))


@pytest.mark.parametrize("kind", style_kinds())
def test_styles_of_every_kind_round_trip(tmp_path, kind):
    path = make_film_run(tmp_path / "run") if kind == "film" else make_run(tmp_path / "run")
    save_style(path, "new style", make_adapter(kind), {"clip": "a.bvh", "error": np.float32(0.5)})
    assert_equal(load_style(load_run(path), "new style"), make_adapter(kind))
    assert list_styles(path) == ("new style",)
    note = style_note(path, "new style")
    assert note["info"] == {"clip": "a.bvh", "error": 0.5}
    assert note["adapter"]["kind"] == kind == make_adapter(kind).config.kind


def test_no_style_is_no_adapter(tmp_path):
    assert load_style(load_run(make_run(tmp_path / "run")), None) is None
    assert list_styles(tmp_path / "run") == ()


def test_saving_one_style_touches_only_its_folder(tmp_path):
    path = make_run(tmp_path / "run")
    save_style(path, "a", make_adapter(), {})

    def contents():
        return {f: f.read_bytes() for f in path.rglob("*") if f.is_file() and "styles/b" not in f.as_posix()}

    before = contents()
    save_style(path, "b", make_adapter(seed=2), {})
    assert contents() == before


def test_a_style_can_be_copied_to_another_run_of_the_same_shared_network(tmp_path):
    first, second = make_run(tmp_path / "first"), make_run(tmp_path / "second")
    save_style(first, "proud", make_adapter(), {})
    shutil.copytree(first / "styles" / "proud", second / "styles" / "proud")
    assert_equal(load_style(load_run(second), "proud"), make_adapter())


def test_a_style_of_another_shared_network_is_refused_by_name(tmp_path):
    first, second = make_run(tmp_path / "first"), make_run(tmp_path / "second", seed=1)
    save_style(first, "proud", make_adapter(), {})
    shutil.copytree(first / "styles" / "proud", second / "styles" / "proud")
    assert_refused(
        lambda: load_style(load_run(second), "proud"),
        file="styles/proud",
        place="shared network",
        rule_mentions="another shared network",
    )


def test_a_style_of_another_rank_is_refused(tmp_path):
    first, second = make_run(tmp_path / "first"), make_run(tmp_path / "second", adapter=AdapterConfig(rank=3))
    save_style(first, "proud", make_adapter(), {})
    shutil.copytree(first / "styles" / "proud", second / "styles" / "proud")
    assert_refused(
        lambda: load_style(load_run(second), "proud"),
        file="styles/proud",
        place="adapter rank",
        value=2,
        rule_mentions="must be 3",
    )
    assert_refused(
        lambda: save_style(second, "old", make_adapter(), {}), place="adapter rank", value=2, rule_mentions="must be 3"
    )


def test_a_style_whose_note_names_another_kind_is_refused(tmp_path):
    path = make_run(tmp_path / "run")
    note = save_style(path, "proud", make_adapter(), {}) / "style.json"
    note.write_text(note.read_text().replace('"cp"', '"diagonal"'))
    assert_refused(
        lambda: load_style(load_run(path), "proud"), file="styles/proud", place="parameter weights", value="absent"
    )
    note.write_text(note.read_text().replace('"diagonal"', '"cubic"'))
    assert_refused(lambda: load_style(load_run(path), "proud"), file="style.json", place="adapter")


def test_an_adapter_of_another_width_is_refused(tmp_path):
    assert_refused(
        lambda: save_style(make_run(tmp_path / "run"), "proud", make_adapter(hidden=8), {}),
        place="adapter",
        rule_mentions="6 hidden units",
    )


def test_an_unknown_style_lists_the_known_ones(tmp_path):
    path = make_run(tmp_path / "run")
    assert_refused(
        lambda: load_style(load_run(path), "proud"), place="style", value="proud", rule_mentions="no styles yet"
    )
    for name in ("old", "angry"):
        save_style(path, name, make_adapter(), {})
    assert_refused(
        lambda: load_style(load_run(path), "proud"), place="style", value="proud", rule_mentions="angry, old"
    )


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a\\b", ".hidden", "a\n", "a\0", "end.", "end ", "c:", "x" * 101]
)
def test_a_style_name_that_is_no_file_name_is_refused(tmp_path, name):
    assert_refused(lambda: save_style(make_run(tmp_path / "run"), name, make_adapter(), {}), place="style name")
    assert_refused(
        lambda: create_run(tmp_path / "other", make_config(styles=(name,)), NORMALISER),
        place="style name",
    )
    assert not (tmp_path / "other").exists()


def test_existing_output_is_refused_without_overwrite(tmp_path):
    path = make_run(tmp_path / "run")
    save_style(path, "old", make_adapter(), {})
    assert_refused(lambda: create_run(path, make_config(), NORMALISER), file="run", place="output", value="exists")
    assert_refused(
        lambda: save_style(path, "old", make_adapter(seed=2), {}), file="styles/old", place="output", value="exists"
    )
    save_style(path, "old", make_adapter(seed=2), {}, overwrite=True)
    assert_equal(load_style(load_run(path), "old"), make_adapter(seed=2))
    create_run(path, make_config(), NORMALISER, overwrite=True)
    assert list_styles(path) == ()


def test_only_a_run_is_overwritten(tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "one.txt").write_text("dear")
    assert_refused(
        lambda: create_run(tmp_path / "letters", make_config(), NORMALISER, overwrite=True),
        place="output",
        value="exists but is not a run directory",
    )
    (tmp_path / "empty").mkdir()
    create_run(tmp_path / "empty", make_config(), NORMALISER)
    assert load_config(tmp_path / "empty") == make_config()


def test_a_run_of_another_layout_is_refused(tmp_path):
    assert_refused(
        lambda: load_run(make_run(tmp_path / "run"), layout="pfnn2017"),
        place="layout",
        value="mason2018",
        rule_mentions="pfnn2017",
    )


def test_no_run_and_no_pretraining_are_refused(tmp_path):
    assert_refused(lambda: load_run(tmp_path), file="config.json", place="file", rule_mentions="run directory")
    create_run(tmp_path / "run", make_config(), NORMALISER)
    assert_refused(lambda: load_run(tmp_path / "run"), place="shared", value="absent")
    assert_refused(lambda: save_style(tmp_path / "run", "old", make_adapter(), {}), file="shared.json", place="file")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("layout", "mason2030", "layout must be one of mason2018, pfnn2017"),
        ("num_joints", 4, "must have 72 inputs"),
        ("network", {"input_size": 66, "output_size": 0}, "output_size"),
        ("adapter", {"kind": "cp", "rank": 0}, "rank must be at least 1"),
        ("colour", "red", "colour"),
        ("styles", None, "iterable"),
        ("skeleton", {"names": []}, "skeleton: no parents"),
    ],
)
def test_a_wrong_configuration_names_the_file_and_the_rule(tmp_path, key, value, message):
    path = make_run(tmp_path / "run")
    data = json.loads((path / "config.json").read_text())
    data[key] = value
    (path / "config.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=message) as error:
        load_run(path)
    assert "config.json" in str(error.value)


def test_a_missing_entry_and_a_foreign_normaliser_are_refused(tmp_path):
    path = make_run(tmp_path / "run")
    for name in ("x_mean.npy", "x_std.npy"):
        np.save(path / "normaliser" / name, np.ones(5, np.float32))
    assert_refused(lambda: load_run(path), file="normaliser", place="columns", value=5, rule_mentions="input_size 66")
    (path / "config.json").write_text("{}")
    assert_refused(lambda: load_config(path), file="config.json", value="network is absent")


def test_training_state_keeps_the_last_good_save(tmp_path, monkeypatch):
    path = make_run(tmp_path / "run")
    assert load_train_state(path, {"a": np.zeros(2)}) is None
    assert train_step(path) is None
    save_train_state(path, {"a": np.full(2, 1.0, np.float32)}, 100)

    def fail(*args):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.ocp, "save", fail)
        assert_refused(
            lambda: save_train_state(path, {"a": np.full(2, 2.0, np.float32)}, 200), file="train_state", place="disk"
        )
    state = load_train_state(path, {"a": np.zeros(2, np.float32)})
    assert state is not None
    np.testing.assert_array_equal(state["a"], np.full(2, 1.0, np.float32))
    assert train_step(path) == 100


def test_a_training_state_of_an_earlier_version_is_refused(tmp_path):
    path = make_run(tmp_path / "run")
    save_train_state(path, {"a": np.zeros(2, np.float32)}, 100)
    note = path / "train_state" / "train_state.json"
    note.write_text('{"step": 100}')
    refused = assert_refused(
        lambda: load_train_state(path, {"a": np.zeros(2, np.float32)}), file="train_state", place="format", value=1
    )
    assert "overwrite=True" in refused.rule
    assert train_step(path) == 100


def test_metrics_survive_a_kill_and_are_not_repeated(tmp_path):
    for step in (1, 2, 3):
        append_metrics(tmp_path, {"step": step, "loss": np.float32(0.5), "nan": float("nan")})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 4, "lo')
    assert [record["step"] for record in read_metrics(tmp_path)] == [1, 2, 3]
    rewind_metrics(tmp_path, step=2)
    append_metrics(tmp_path, {"step": 3})
    assert read_metrics(tmp_path) == [*({"step": s, "loss": 0.5, "nan": None} for s in (1, 2)), {"step": 3}]
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "metrics.jsonl").symlink_to("/dev/full")
    assert_refused(lambda: append_metrics(tmp_path / "full", {"step": 1}), file="metrics.jsonl", place="disk")
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\nnonsense\n')
    assert_refused(lambda: read_metrics(tmp_path), file="metrics.jsonl", place="line 2")


GENERATOR = GeneratorConfig(features=6 * JOINTS, clip_frames=8, filters=4, width=3, hidden=5, film_hidden=HIDDEN)


def make_film_run(path):
    return make_run(path, adapter=AdapterConfig("film"), generator=GENERATOR)


def test_a_generator_round_trips(tmp_path):
    path = make_film_run(tmp_path / "run")
    parameters = FiLMGenerator.init(GENERATOR, key=jax.random.key(2))
    save_generator(path, parameters)
    run = load_run(path)
    assert run.config.generator == GENERATOR
    assert_equal(load_generator(run), parameters)
    save_style(path, "angry", make_adapter("film"), {})
    assert_equal(load_style(run, "angry"), make_adapter("film"))


def test_a_generator_saved_as_a_dictionary_loads(tmp_path):
    """Earlier versions kept the generator's parameters as dictionaries of the same names."""
    path = make_film_run(tmp_path / "run")
    generator = FiLMGenerator.init(GENERATOR, key=jax.random.key(2))
    layers = {name: getattr(generator, name) for name in ("conv1", "conv2", "dense1", "dense2")}
    save_generator(path, {name: {"kernel": layer.kernel, "bias": layer.bias} for name, layer in layers.items()})
    assert_equal(load_generator(load_run(path)), generator)


def test_a_run_without_a_generator_says_so(tmp_path):
    assert_refused(lambda: load_generator(load_run(make_run(tmp_path / "run"))), place="generator", value="absent")


def test_a_generator_of_another_shared_network_is_refused(tmp_path):
    path = make_film_run(tmp_path / "run")
    save_generator(path, FiLMGenerator.init(GENERATOR, key=jax.random.key(2)))
    save_shared(path, init_network(make_config().network, key=jax.random.key(9)))
    assert_refused(lambda: load_generator(load_run(path)), place="shared network", rule_mentions="the generator")


def test_mixing_film_and_adapter_styles_is_refused(tmp_path):
    assert_refused(
        lambda: save_style(make_run(tmp_path / "adapters"), "angry", make_adapter("film"), {}),
        place="adapter kind",
        value="film",
    )
    assert_refused(
        lambda: save_style(make_film_run(tmp_path / "films"), "angry", make_adapter("cp"), {}),
        place="adapter kind",
        value="cp",
    )


def test_a_configuration_written_before_there_were_generators_loads(tmp_path):
    path = make_run(tmp_path / "run")
    file, old = path / "config.json", load_run(path).config
    data = json.loads(file.read_text())
    for name in ("generator", "command_gain"):
        del data[name]
    for name in ("phase_size", "gating_hidden"):
        del data["network"][name]
    file.write_text(json.dumps(data))
    assert load_run(path).config == old


def test_a_gating_network_needs_a_layout_and_statistics_of_phases(tmp_path):
    gated = dataclasses.replace(make_config().network, phase_size=8)
    with pytest.raises(ValueError, match="must have phase_size 0 for layout mason2018, got 8"):
        make_config(network=gated)
    phases = Statistics(np.zeros(8, np.float32), np.ones(8, np.float32))
    path = tmp_path / "run"
    config = make_config()
    create_run(path, config, dataclasses.replace(NORMALISER, phases=phases))
    save_shared(path, init_network(config.network, key=jax.random.key(0)))
    assert_refused(lambda: load_run(path), place="phase columns", value=8)
