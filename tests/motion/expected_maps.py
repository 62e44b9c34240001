"""The humanoid maps of skeletons that people use, as read by eye from their names, places and VRM maps."""

from __future__ import annotations

from pfnn_jax.motion.humanoid.map import ARM, BONES, LEG

Names = dict[str, str | list[str] | None]


def expected(trunk: str, arm: str, leg: str, sides: tuple[str, str] = ("Left", "Right")) -> Names:
    """Returns bone -> joint names, as `HumanoidMap.names` does.

    Args:
        trunk: names of hips, spine, neck and head, divided by `|`; spine and neck are several words or none, `-` is
            no joint.
        arm: names from clavicle to hand, with `{}` for the side.
        leg: names from thigh to toe.
        sides: words for left and right.
    """
    hips, spine, neck, head = (part.strip() for part in trunk.split("|"))
    found: Names = {"hips": hips, "spine": spine.split(), "neck": neck.split(), "head": None if head == "-" else head}
    for side, word in zip(("left", "right"), sides, strict=True):
        for parts, names in ((ARM, arm), (LEG, leg)):
            for part, name in zip(parts, names.split(), strict=True):
                found[f"{side}_{part}"] = None if name == "-" else name.format(word)
    return {bone: found[bone] for bone in BONES}


SHORT = ("L", "R")
SMALL = ("l", "r")
MIXAMO_ARM, MIXAMO_LEG = "{}Shoulder {}Arm {}ForeArm {}Hand", "{}UpLeg {}Leg {}Foot {}ToeBase"
XSENS_ARM, XSENS_LEG = "{}Collar {}Shoulder {}Elbow {}Wrist", "{}Hip {}Knee {}Ankle {}Toe"
BLENDER_ARM, BLENDER_LEG = "shoulder.{} upper_arm.{} forearm.{} hand.{}", "thigh.{} shin.{} foot.{} toe.{}"

CMU = expected("Hips|LowerBack Spine Spine1|Neck Neck1|Head", MIXAMO_ARM, MIXAMO_LEG)
XSENS = expected("Hips|Chest Chest2 Chest3 Chest4|Neck|Head", XSENS_ARM, XSENS_LEG)
BANDAI = expected(
    "Hips|Spine Chest|Neck|Head",
    "Shoulder_{} UpperArm_{} LowerArm_{} Hand_{}",
    "UpperLeg_{} LowerLeg_{} Foot_{} Toes_{}",
    SHORT,
)
FOUR_SPINES = expected("Hips|Spine Spine1 Spine2 Spine3|Neck|Head", MIXAMO_ARM, MIXAMO_LEG)
THREE_SPINES = expected("Hips|Spine Spine1 Spine2|Neck|Head", MIXAMO_ARM, MIXAMO_LEG)
MAKEHUMAN_WALK = expected(
    "Hips|Spine1 Spine2 Spine3|Neck|Head",
    "Clavicle_{} UpArm_{} LoArm_{} Hand_{}",
    "UpLeg_{} LoLeg_{} Foot_{} Toe_{}",
    SHORT,
)

MOCAP: dict[str, Names] = {
    "100style/Neutral_FW.bvh": XSENS,
    "bandai-namco-1/dataset-1_walk_normal_001.bvh": BANDAI,
    "bandai-namco-2/dataset-2_walk_normal_001.bvh": BANDAI,
    "xia/neutral_01_000.bvh": CMU,
    "xia-test/old_01_000.bvh": CMU,
    "pfnn/LocomotionFlat04_000.bvh": CMU,
    "pfnn/NewCaptures10_000_mirror.bvh": CMU,
    "pfnn/rest.bvh": CMU,
    "field/axis_neuron.bvh": expected(
        "Hips|Spine Spine1 Spine2 Spine3|Neck|Head", MIXAMO_ARM, "{}UpLeg {}Leg {}Foot -"
    ),
    "field/boxing_plus_one.bvh": expected("Hips|Ab Chest|Neck|Head", XSENS_ARM, "{}Hip {}Knee {}Ankle {}Toes"),
    "field/cgspeed_daz.bvh": expected(
        "hip|abdomen chest|neck|head", "{}Collar {}Shldr {}ForeArm {}Hand", "{}Thigh {}Shin {}Foot -", SMALL
    ),
    "field/child5_inches.bvh": FOUR_SPINES,
    "field/dfki_walk.bvh": expected(
        "FK_back1_jnt|FK_back2_jnt FK_back3_jnt|FK_back4_jnt|head_jnt",
        "{}_shoulder_jnt {}_upArm_jnt {}_lowArm_jnt {}_hand_jnt",
        "{}_upLeg_jnt {}_lowLeg_jnt {}_foot_jnt {}_toe_jnt",
        SHORT,
    ),
    "field/kimodo_soma_elderly.bvh": expected(
        "Hips|Spine1 Spine2 Chest|Neck1 Neck2|Head", MIXAMO_ARM, "{}Leg {}Shin {}Foot {}ToeBase"
    ),
    "field/makehuman_tpose_zero_positions.bvh": expected(
        "root|spine05 spine04 spine03 spine02 spine01|neck01 neck02 neck03|head",
        "clavicle.{} upperarm01.{} lowerarm01.{} wrist.{}",
        "upperleg01.{} lowerleg01.{} foot.{} toe1-1.{}",
        SHORT,
    ),
    "field/makehuman_walk_decimetres.bvh": MAKEHUMAN_WALK,
    "field/makehuman_walk_pairs.bvh": MAKEHUMAN_WALK,
    "field/mass_walk.bvh": expected(
        "Character1_Hips|Character1_Spine Character1_Spine1|Character1_Neck|Character1_Head",
        "Character1_{}Shoulder Character1_{}Arm Character1_{}ForeArm Character1_{}Hand",
        "Character1_{}UpLeg Character1_{}Leg Character1_{}Foot Character1_{}ToeBase",
    ),
    "field/mixamorig_colon.bvh": expected(
        "mixamorig:Hips|mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2|mixamorig:Neck|mixamorig:Head",
        " ".join(f"mixamorig:{name}" for name in MIXAMO_ARM.split()),
        " ".join(f"mixamorig:{name}" for name in MIXAMO_LEG.split()),
    ),
    "field/momask_walk.bvh": expected("Hips|Spine Spine1 Spine2|Neck|Head", MIXAMO_ARM, "{}UpLeg {}Leg {}Foot {}Toe"),
    "field/no_namespace.bvh": THREE_SPINES,
    "field/noitom_like_desk.bvh": XSENS,
    "field/olaf_walk_24fps.bvh": expected("Hips|Spine Spine1|Neck|Head", MIXAMO_ARM, "{}UpLeg {}Leg {}Foot -"),
    "field/rokoko_dance.bvh": THREE_SPINES,
    "field/runs_touch.bvh": XSENS,
    "field/skating_steps_missed.bvh": XSENS,
    "field/slimevr_head_root.bvh": expected(
        "Hip|Waist Chest|Neck|Head", "- - - -", "{}-Hip {}-Knee {}-Ankle {}-Foot", ("Left", "Right")
    ),
    "field/stylised_24fps.bvh": CMU,
    "field/sway.bvh": FOUR_SPINES,
    "field/univrm.bvh": expected("Hips|Spine Spine1|Neck|Head", MIXAMO_ARM, MIXAMO_LEG),
    "field/wham.bvh": expected(
        "pelvis|spine1 spine2 spine3|neck|head",
        "{}_collar {}_shoulder {}_elbow {}_wrist",
        "{}_hip {}_knee {}_ankle {}_foot",
        ("left", "right"),
    ),
}
"""File -> map."""

KAYKIT = expected(
    "hips|spine chest||head",
    "- upperarm.{} lowerarm.{} wrist.{}",
    "upperleg.{} lowerleg.{} foot.{} toes.{}",
    SMALL,
)

CHARACTERS: dict[str, Names] = {
    "cesiumman": {
        **expected(
            "Skeleton_torso_joint_1|Skeleton_torso_joint_2 torso_joint_3|Skeleton_neck_joint_1|Skeleton_neck_joint_2",
            "- Skeleton_arm_joint_{}__4_ Skeleton_arm_joint_{}__3_ Skeleton_arm_joint_{}__2_",
            "leg_joint_{}_1 leg_joint_{}_2 leg_joint_{}_3 leg_joint_{}_5",
            SHORT,
        ),
        "right_upper_arm": "Skeleton_arm_joint_R",
        "right_lower_arm": "Skeleton_arm_joint_R__2_",
        "right_hand": "Skeleton_arm_joint_R__3_",
    },
    "godot_platformer": expected(
        "hip|waist chest|neck|head", "- {}-arm {}-forearm -", "{}-thigh {}-leg {}-foot -", SMALL
    ),
    "kaykit_mage": KAYKIT,
    "kaykit_manny": KAYKIT,
    "metarig_hackmit": expected(
        "spine|Bone spine.003|spine.004 spine.005|spine.006",
        "shoulder.{} upper_arm.{} forearm.{} -",
        "thigh.{} shin.{} - -",
        SHORT,
    ),
    "metarig_malebase": expected(
        "spine|spine.001 spine.002 spine.003|spine.004|spine.005", BLENDER_ARM, BLENDER_LEG, SHORT
    ),
    "mixamo_hunter": expected(
        "mixamorigHips|mixamorigSpine mixamorigSpine1 mixamorigSpine2|mixamorigNeck|mixamorigHead",
        " ".join(f"mixamorig{name}" for name in MIXAMO_ARM.split()),
        " ".join(f"mixamorig{name}" for name in MIXAMO_LEG.split()),
    ),
    "mixamo_toram": MOCAP["field/mixamorig_colon.bvh"],
    "quaternius_adventurer": expected(
        "Body|Hips Abdomen Torso Chest|Neck|Head",
        "Shoulder.{} UpperArm.{} LowerArm.{} Wrist.{}",
        "UpperLeg.{} LowerLeg.{} Foot.{} -",
        SHORT,
    ),
    "quaternius_platformer": expected(
        "Body|Hips Abdomen Torso|Neck|Head",
        "Shoulder.{} UpperArm.{} LowerArm.{} Fist.{}",
        "UpperLeg.{} LowerLeg.{} Foot.{} -",
        SHORT,
    ),
    "quaternius_robotexpressive": expected(
        "Body|Hips Abdomen Torso_1|Neck|Head_1",
        "Shoulder{} UpperArm{} LowerArm{} Palm2{}",
        "UpperLeg{} LowerLeg{} Foot{} -",
        SHORT,
    ),
    # the spine that the arms hang from is that of the controls; the deforming one is a chain of its own
    "rigify_lumberjack": {
        **expected(
            "torso_07|spine_fk.002_030 spine_fk.003_032|DEF-neck_050|DEF-head_051",
            "- DEF-upper_arm.{} DEF-forearm.{} DEF-hand.{}",
            "DEF-thigh.{} DEF-shin.{} DEF-foot.{} DEF-toe.{}",
            SHORT,
        ),
        "left_upper_arm": "DEF-upper_arm.L_045",
        "left_lower_arm": "DEF-forearm.L_047",
        "left_hand": "DEF-hand.L_049",
        "right_upper_arm": "DEF-upper_arm.R_037",
        "right_lower_arm": "DEF-forearm.R_039",
        "right_hand": "DEF-hand.R_041",
        "left_thigh": "DEF-thigh.L_023",
        "left_shin": "DEF-shin.L_025",
        "left_foot": "DEF-foot.L_027",
        "left_toe": "DEF-toe.L_028",
        "right_thigh": "DEF-thigh.R_015",
        "right_shin": "DEF-shin.R_017",
        "right_foot": "DEF-foot.R_019",
        "right_toe": "DEF-toe.R_020",
    },
    "rigify_mannyquin": expected(
        "DEF-hips|DEF-spine.001 DEF-spine.002 DEF-spine.003|DEF-neck|DEF-head",
        " ".join(f"DEF-{name}" for name in BLENDER_ARM.split()),
        " ".join(f"DEF-{name}" for name in BLENDER_LEG.split()),
        SHORT,
    ),
    "sketchbook_boxman": expected(
        "body_IK|body_lower body_upper||head", "- arm_upper.{} arm_lower.{} -", "leg_upper.{} leg_lower.{} - -", SHORT
    ),
    "ue_mannequin_f": expected(
        "pelvis|spine_01 spine_02 spine_03|neck_01|Head",
        "clavicle_{} upperarm_{} lowerarm_{} hand_{}",
        "thigh_{} calf_{} foot_{} ball_{}",
        SMALL,
    ),
    "ue_mannequiny": expected(
        "pelvis|spine_01 spine_02|neck_01|head",
        "clavicle.{} upperarm.{} lowerarm.{} hand.{}",
        "thigh.{} calf.{} foot.{} ball.{}",
        SMALL,
    ),
    "vrm0_cryptovoxels": {
        bone: name.replace("_", " ") if isinstance(name, str) else name
        for bone, name in expected(
            "Hips|Spine Chest|Neck|Head",
            "{}_shoulder {}_arm {}_elbow {}_wrist",
            "{}_leg {}_knee {}_ankle {}_toe",
        ).items()
    },
    "vrm0_godette": expected(
        "pelvis_Armature|tummy_Armature chest_Armature|neck_Armature|head_Armature",
        "shoulder.{}_Armature upper_arm.{}_Armature lowerarm.{}_Armature hand.{}_Armature",
        "thigh.{}_Armature shin.{}_Armature foot.{}_Armature toes.{}_Armature",
        SMALL,
    ),
    "vrm1_example": expected(
        "hips|spine chest|neck|head",
        "shoulder.{} upper_arm.{} lower_arm.{} hand.{}",
        "upper_leg.{} lower_leg.{} foot.{} toes.{}",
        SHORT,
    ),
}
"""Name of a character -> map, apart from `derived_noname`, which has no names."""

NO_NAMES = expected(
    "1|2 3 4|5|6",
    "{0[0]} {0[1]} {0[2]} {0[3]}",
    "{0[4]} {0[5]} {0[6]} {0[7]}",
    ([7, 8, 9, 10, 55, 56, 57, 58], [31, 32, 33, 34, 60, 61, 62, 63]),  # pyright: ignore[reportArgumentType]
)
"""The map of `derived_noname`, by indices in its list of joints: the same rig as `ue_mannequin_f`."""
