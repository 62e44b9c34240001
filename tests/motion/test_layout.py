"""Layouts: sizes, exact slices of the two papers, names in errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pfnn_jax.motion.features.layout import (
    LAYOUTS,
    Interleaved,
    block_columns,
    column_names,
    layout_for,
    mason2018,
    mason2022,
    mason2022_mann,
    mason2022_pfnn,
    pfnn2017,
)
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import MAX_JOINTS
from tests.motion.skeletons import body
from tests.raising import assert_refused

MASON_INPUTS = {
    "trajectory_position_x": slice(0, 12),
    "trajectory_position_z": slice(12, 24),
    "trajectory_direction_x": slice(24, 36),
    "trajectory_direction_z": slice(36, 48),
    "joint_position": slice(48, 141),
    "joint_velocity": slice(141, 234),
}
MASON_OUTPUTS = {
    "trajectory_position_x": slice(0, 6),
    "trajectory_position_z": slice(6, 12),
    "trajectory_direction_x": slice(12, 18),
    "trajectory_direction_z": slice(18, 24),
    "joint_position": slice(24, 117),
    "joint_velocity": slice(117, 210),
    "joint_forward": slice(210, 303),
    "joint_up": slice(303, 396),
    "phase_change": slice(396, 397),
    "root_velocity": slice(397, 399),
    "root_yaw_rate": slice(399, 400),
}
PFNN_INPUTS = {
    "trajectory_position_x": slice(0, 12),
    "trajectory_position_z": slice(12, 24),
    "trajectory_direction_x": slice(24, 36),
    "trajectory_direction_z": slice(36, 48),
    "gait": slice(48, 120),
    "joint_position": slice(120, 213),
    "joint_velocity": slice(213, 306),
    "terrain_height": slice(306, 342),
}
PFNN_OUTPUTS = {
    "root_velocity": slice(0, 2),
    "root_yaw_rate": slice(2, 3),
    "phase_change": slice(3, 4),
    "contacts": slice(4, 8),
    "trajectory_position_x": slice(8, 14),
    "trajectory_position_z": slice(14, 20),
    "trajectory_direction_x": slice(20, 26),
    "trajectory_direction_z": slice(26, 32),
    "joint_position": slice(32, 125),
    "joint_velocity": slice(125, 218),
    "joint_rotation": slice(218, 311),
}


@pytest.mark.parametrize(
    ("layout", "inputs", "outputs"),
    [(mason2018(), MASON_INPUTS, MASON_OUTPUTS), (pfnn2017(), PFNN_INPUTS, PFNN_OUTPUTS)],
)
def test_slices_are_those_of_the_papers(layout, inputs, outputs):
    assert {name: layout.input_slice(name) for name in layout.input_blocks} == inputs
    assert {name: layout.output_slice(name) for name in layout.output_blocks} == outputs


@pytest.mark.parametrize(
    ("name", "joints", "sizes"),
    [
        ("mason2018", 31, (234, 400)),
        ("mason2018", 21, (174, 280)),
        ("mason2018", 23, (186, 304)),
        ("pfnn2017", 31, (342, 311)),
        ("pfnn2017", 21, (282, 221)),
        ("mason2022", 25, (348, 342)),
        ("mason2022", 21, (300, 294)),
        ("mason2022_mann", 25, (348, 326)),
        ("mason2022_pfnn", 25, (348, 327)),
    ],
)
def test_sizes_follow_one_rule_at_any_number_of_joints(name, joints, sizes):
    layout = LAYOUTS[name](joints)
    assert (layout.input_size, layout.output_size) == sizes
    assert layout.name == name


def test_unknown_block_lists_the_blocks():
    with pytest.raises(KeyError, match=r"No output block 'joint_vel' in layout mason2018; it has .*joint_velocity"):
        mason2018().output_slice("joint_vel")
    with pytest.raises(KeyError, match=r"No input block 'joint_up'"):
        mason2018().input_slice("joint_up")
    assert mason2018().has_output("joint_up") and not mason2018().has_input("joint_up")


def test_impossible_layouts_are_refused():
    with pytest.raises(ValueError, match="num_joints must be 1 to"):
        mason2018(0)
    for layout in LAYOUTS.values():  # of a damaged file: the columns of so many joints would fill the memory
        with pytest.raises(ValueError, match="num_joints must be 1 to"):
            layout(MAX_JOINTS + 1)
    with pytest.raises(ValueError, match="units must be positive"):
        dataclasses.replace(mason2018(), fps=0.0)
    for ends in ((1, 2, 3), (1, 2, 3, 25)):
        with pytest.raises(ValueError, match="ends must be 4 of 25 joints"):
            mason2022(25, ends)


# interleaved layouts


def test_samples_and_joints_are_interleaved_as_in_the_published_weights():
    layout = mason2022()
    for sample in range(12):
        for offset, block in enumerate(("position_x", "position_z", "direction_x", "direction_z")):
            where = np.r_[layout.input_slice(f"trajectory_{block}")]
            assert where[sample] == 4 * sample + offset and len(where) == 12
            if sample < 6:
                assert np.r_[layout.output_slice(f"trajectory_{block}")][sample] == 4 * sample + offset
    for part, block in enumerate(("joint_position", "joint_forward", "joint_up", "joint_velocity")):
        joints = np.arange(25)[:, None]
        wanted = (12 * joints + 3 * part + np.arange(3)).ravel()
        np.testing.assert_array_equal(layout.input_slice(block), 48 + wanted)
        np.testing.assert_array_equal(layout.output_slice(block), 24 + wanted)
    assert layout.output_slice("local_phase") == slice(324, 332)
    assert layout.output_slice("local_phase_change") == slice(332, 340)
    assert layout.output_slice("foot_contacts") == slice(340, 342)


def test_backbones_differ_in_their_last_outputs_and_gating_input():
    local, velocity, scalar = mason2022(), mason2022_mann(), mason2022_pfnn()
    assert (local.phase_size, velocity.phase_size, scalar.phase_size, mason2018().phase_size) == (8, 12, 0, 0)
    assert local.inputs == velocity.inputs == scalar.inputs
    assert velocity.output_blocks[-1:] == ("foot_contacts",)
    assert scalar.output_blocks[-2:] == ("foot_contacts", "phase_change")
    assert local.ends == velocity.ends == (16, 11, 24, 20) and scalar.ends == ()


@pytest.mark.parametrize("layout", [make(25) for make in LAYOUTS.values()], ids=lambda layout: layout.name)
def test_every_column_belongs_to_one_block(layout):
    for blocks, names, find, width in (
        (layout.input_blocks, layout.input_names, layout.input_slice, layout.input_width),
        (layout.output_blocks, layout.output_names, layout.output_slice, layout.output_width),
    ):
        owners = np.full(len(names), -1)
        for index, block in enumerate(blocks):
            columns = np.r_[find(block)]
            assert len(columns) == width(block) and (np.diff(columns) > 0).all()
            assert (owners[columns] == -1).all()
            owners[columns] = index
        assert [blocks[owner] for owner in owners] == list(names)


def test_a_block_is_a_slice_where_its_columns_are_regular():
    blocks = (("a", 2), Interleaved(3, (("b", 1), ("c", 2))), ("d", 1))
    assert column_names(blocks) == ("a", "a", "b", "c", "c", "b", "c", "c", "b", "c", "c", "d")
    columns = block_columns(blocks)
    assert columns["a"] == slice(0, 2) and columns["b"] == slice(2, 9, 3) and columns["d"] == slice(11, 12)
    indices = columns["c"]
    assert isinstance(indices, np.ndarray) and indices.tolist() == [3, 4, 6, 7, 9, 10] and not indices.flags.writeable


@pytest.mark.parametrize("blocks", [(("a", 1), ("a", 2)), (("a", 0),), (Interleaved(0, (("a", 1),)),)])
def test_blocks_need_columns_and_unique_names(blocks):
    with pytest.raises(ValueError, match="block|Block"):
        block_columns(blocks)


def test_layout_for_finds_hands_and_toes():
    skeleton = assign_roles(body())
    assert layout_for("mason2022", skeleton).ends == (7, 11, 15, 19)
    assert layout_for("mason2022_pfnn", skeleton).ends == () and layout_for("mason2018", skeleton) == mason2018(20)
    assert LAYOUTS["mason2022"](20).ends == ()  # not known without a skeleton
    assert_refused(lambda: layout_for("mason2022", body()), place="skeleton")
    with pytest.raises(KeyError):
        layout_for("mason2023", skeleton)
