"""Layouts: sizes, exact slices of the two papers, names in errors."""

from __future__ import annotations

import dataclasses

import pytest

from pfnn_jax.motion.layout import LAYOUTS, mason2018, pfnn2017

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
    assert {name: layout.input_slice(name) for name, _ in layout.inputs} == inputs
    assert {name: layout.output_slice(name) for name, _ in layout.outputs} == outputs


@pytest.mark.parametrize(
    ("name", "joints", "sizes"),
    [
        ("mason2018", 31, (234, 400)),
        ("mason2018", 21, (174, 280)),
        ("mason2018", 23, (186, 304)),
        ("pfnn2017", 31, (342, 311)),
        ("pfnn2017", 21, (282, 221)),
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
    with pytest.raises(ValueError, match="num_joints must be at least 1"):
        mason2018(0)
    with pytest.raises(ValueError, match="units must be positive"):
        dataclasses.replace(mason2018(), fps=0.0)
