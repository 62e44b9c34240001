"""Joint names of programs whose files are not among the recorded ones, on the same body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.humanoid.map import BONES
from pfnn_jax.motion.humanoid.pairs import find_mirror
from tests.motion.rigs import tree

Place = tuple[float, float, float]
TRUNK: dict[str, Place] = {"hips": (0, 0.95, 0), "head": (0, 1.6, 0.02), "neck": (0, 1.48, 0), "chest": (0, 1.3, 0)}
LIMBS: dict[str, Place] = {
    "clavicle": (0.03, 1.42, 0),
    "upper_arm": (0.18, 1.42, 0),
    "lower_arm": (0.46, 1.42, -0.01),
    "hand": (0.71, 1.42, 0),
    "thigh": (0.09, 0.92, 0),
    "shin": (0.09, 0.5, 0.01),
    "foot": (0.09, 0.08, 0),
    "toe": (0.09, 0.02, 0.13),
}

# Each joint: bone or place:name>parent's name. Helper joints have a place near the bone after the @.
CONVENTIONS = {
    "character creator": """
        @hips:CC_Base_BoneRoot hips:CC_Base_Hip>CC_Base_BoneRoot @hips:CC_Base_Pelvis>CC_Base_Hip
        spine:CC_Base_Waist>CC_Base_Hip spine:CC_Base_Spine01>CC_Base_Waist spine:CC_Base_Spine02>CC_Base_Spine01
        neck:CC_Base_NeckTwist01>CC_Base_Spine02 neck:CC_Base_NeckTwist02>CC_Base_NeckTwist01
        head:CC_Base_Head>CC_Base_NeckTwist02 @head:CC_Base_FacialBone>CC_Base_Head
        clavicle:CC_Base_{L}_Clavicle>CC_Base_Spine02 upper_arm:CC_Base_{L}_Upperarm>CC_Base_{L}_Clavicle
        @upper_arm:CC_Base_{L}_UpperarmTwist01>CC_Base_{L}_Upperarm
        lower_arm:CC_Base_{L}_Forearm>CC_Base_{L}_Upperarm hand:CC_Base_{L}_Hand>CC_Base_{L}_Forearm
        @hand:CC_Base_{L}_Thumb1>CC_Base_{L}_Hand
        thigh:CC_Base_{L}_Thigh>CC_Base_Pelvis @shin:CC_Base_{L}_KneeShareBone>CC_Base_{L}_Thigh
        shin:CC_Base_{L}_Calf>CC_Base_{L}_Thigh @shin:CC_Base_{L}_CalfTwist01>CC_Base_{L}_Calf
        foot:CC_Base_{L}_Foot>CC_Base_{L}_Calf toe:CC_Base_{L}_ToeBase>CC_Base_{L}_Foot
        @toe:CC_Base_{L}_BigToe1>CC_Base_{L}_ToeBase""",
    "biped, thighs under the spine": """
        @hips:Bip01 hips:Bip01_Pelvis>Bip01 spine:Bip01_Spine>Bip01_Pelvis spine:Bip01_Spine1>Bip01_Spine
        neck:Bip01_Neck>Bip01_Spine1 head:Bip01_Head>Bip01_Neck @head:Bip01_HeadNub>Bip01_Head
        clavicle:Bip01_{L}_Clavicle>Bip01_Neck upper_arm:Bip01_{L}_UpperArm>Bip01_{L}_Clavicle
        lower_arm:Bip01_{L}_Forearm>Bip01_{L}_UpperArm hand:Bip01_{L}_Hand>Bip01_{L}_Forearm
        @hand:Bip01_{L}_Finger0>Bip01_{L}_Hand thigh:Bip01_{L}_Thigh>Bip01_Spine shin:Bip01_{L}_Calf>Bip01_{L}_Thigh
        foot:Bip01_{L}_Foot>Bip01_{L}_Calf toe:Bip01_{L}_Toe0>Bip01_{L}_Foot @toe:Bip01_{L}_Toe0Nub>Bip01_{L}_Toe0""",
    "daz": """
        hips:hip @hips:pelvis>hip spine:abdomenLower>hip spine:abdomenUpper>abdomenLower spine:chestLower>abdomenUpper
        spine:chestUpper>chestLower neck:neckLower>chestUpper neck:neckUpper>neckLower head:head>neckUpper
        clavicle:{l}Collar>chestUpper upper_arm:{l}ShldrBend>{l}Collar @upper_arm:{l}ShldrTwist>{l}ShldrBend
        lower_arm:{l}ForearmBend>{l}ShldrTwist @lower_arm:{l}ForearmTwist>{l}ForearmBend hand:{l}Hand>{l}ForearmTwist
        thigh:{l}ThighBend>pelvis @thigh:{l}ThighTwist>{l}ThighBend shin:{l}Shin>{l}ThighTwist foot:{l}Foot>{l}Shin
        toe:{l}Toe>{l}Foot""",
    "xsens": """
        hips:Pelvis spine:L5>Pelvis spine:L3>L5 spine:T12>L3 spine:T8>T12 neck:Neck>T8 head:Head>Neck
        clavicle:{Left}Shoulder>T8 upper_arm:{Left}UpperArm>{Left}Shoulder lower_arm:{Left}ForeArm>{Left}UpperArm
        hand:{Left}Hand>{Left}ForeArm thigh:{Left}UpperLeg>Pelvis shin:{Left}LowerLeg>{Left}UpperLeg
        foot:{Left}Foot>{Left}LowerLeg toe:{Left}Toe>{Left}Foot""",
    "kinect": """
        hips:SpineBase spine:SpineMid>SpineBase spine:SpineShoulder>SpineMid neck:Neck>SpineShoulder head:Head>Neck
        upper_arm:Shoulder{Left}>SpineShoulder lower_arm:Elbow{Left}>Shoulder{Left} hand:Wrist{Left}>Elbow{Left}
        @hand:Hand{Left}>Wrist{Left} @hand:HandTip{Left}>Hand{Left} thigh:Hip{Left}>SpineBase shin:Knee{Left}>Hip{Left}
        foot:Ankle{Left}>Knee{Left} toe:Foot{Left}>Ankle{Left}""",
    "azure kinect": """
        hips:PELVIS spine:SPINE_NAVEL>PELVIS spine:SPINE_CHEST>SPINE_NAVEL neck:NECK>SPINE_CHEST head:HEAD>NECK
        @head:EYE_{LEFT}>HEAD clavicle:CLAVICLE_{LEFT}>SPINE_CHEST upper_arm:SHOULDER_{LEFT}>CLAVICLE_{LEFT}
        lower_arm:ELBOW_{LEFT}>SHOULDER_{LEFT} hand:WRIST_{LEFT}>ELBOW_{LEFT} @hand:HAND_{LEFT}>WRIST_{LEFT}
        @hand:THUMB_{LEFT}>WRIST_{LEFT} thigh:HIP_{LEFT}>PELVIS shin:KNEE_{LEFT}>HIP_{LEFT}
        foot:ANKLE_{LEFT}>KNEE_{LEFT}
        toe:FOOT_{LEFT}>ANKLE_{LEFT}""",
    "optitrack": """
        hips:Hip spine:Ab>Hip spine:Chest>Ab neck:Neck>Chest head:Head>Neck clavicle:{L}Shoulder>Chest
        upper_arm:{L}UArm>{L}Shoulder lower_arm:{L}FArm>{L}UArm hand:{L}Hand>{L}FArm thigh:{L}Thigh>Hip
        shin:{L}Shin>{L}Thigh foot:{L}Foot>{L}Shin toe:{L}Toe>{L}Foot""",
    "acclaim": """
        hips:root @hips:{l}hipjoint>root thigh:{l}femur>{l}hipjoint shin:{l}tibia>{l}femur foot:{l}foot>{l}tibia
        toe:{l}toes>{l}foot spine:lowerback>root spine:upperback>lowerback spine:thorax>upperback
        neck:lowerneck>thorax neck:upperneck>lowerneck head:head>upperneck clavicle:{l}clavicle>thorax
        upper_arm:{l}humerus>{l}clavicle lower_arm:{l}radius>{l}humerus hand:{l}wrist>{l}radius @hand:{l}hand>{l}wrist
        @hand:{l}fingers>{l}hand @hand:{l}thumb>{l}wrist""",
    "second life": """
        hips:mPelvis spine:mTorso>mPelvis spine:mChest>mTorso neck:mNeck>mChest head:mHead>mNeck @head:mSkull>mHead
        clavicle:mCollar{Left}>mChest upper_arm:mShoulder{Left}>mCollar{Left} lower_arm:mElbow{Left}>mShoulder{Left}
        hand:mWrist{Left}>mElbow{Left} thigh:mHip{Left}>mPelvis shin:mKnee{Left}>mHip{Left}
        foot:mAnkle{Left}>mKnee{Left} @toe:mFoot{Left}>mAnkle{Left} toe:mToe{Left}>mFoot{Left}""",
    "auto-rig pro": """
        hips:root.x spine:spine_01.x>root.x spine:spine_02.x>spine_01.x neck:neck.x>spine_02.x head:head.x>neck.x
        clavicle:shoulder.{l}>spine_02.x upper_arm:arm_stretch.{l}>shoulder.{l} @lower_arm:arm_twist.{l}>arm_stretch.{l}
        lower_arm:forearm_stretch.{l}>arm_stretch.{l} hand:hand.{l}>forearm_stretch.{l} thigh:thigh_stretch.{l}>root.x
        shin:leg_stretch.{l}>thigh_stretch.{l} foot:foot.{l}>leg_stretch.{l} toe:toes_01.{l}>foot.{l}""",
    "unreal 5": """
        @hips:root hips:pelvis>root spine:spine_01>pelvis spine:spine_02>spine_01 spine:spine_03>spine_02
        clavicle:clavicle_{l}>spine_03 upper_arm:upperarm_{l}>clavicle_{l} lower_arm:lowerarm_{l}>upperarm_{l}
        @lower_arm:lowerarm_twist_01_{l}>lowerarm_{l} hand:hand_{l}>lowerarm_{l}
        @upper_arm:upperarm_twist_01_{l}>upperarm_{l}
        neck:neck_01>spine_03 neck:neck_02>neck_01 head:head>neck_02 thigh:thigh_{l}>pelvis shin:calf_{l}>thigh_{l}
        @shin:calf_twist_01_{l}>calf_{l} foot:foot_{l}>calf_{l} toe:ball_{l}>foot_{l} @foot:ik_foot_root>root
        @foot:ik_foot_{l}>ik_foot_root @hand:ik_hand_root>root @hand:ik_hand_{l}>ik_hand_root""",
    "human ik": """
        hips:Hips spine:Spine>Hips spine:Spine1>Spine neck:Neck>Spine1 head:Head>Neck @head:HeadEnd>Head
        clavicle:{Left}Shoulder>Spine1 upper_arm:{Left}Arm>{Left}Shoulder @upper_arm:{Left}ArmRoll>{Left}Arm
        lower_arm:{Left}ForeArm>{Left}ArmRoll @hand:{Left}ForeArmRoll>{Left}ForeArm hand:{Left}Hand>{Left}ForeArmRoll
        thigh:{Left}UpLeg>Hips @thigh:{Left}UpLegRoll>{Left}UpLeg shin:{Left}Leg>{Left}UpLegRoll
        foot:{Left}Foot>{Left}Leg
        toe:{Left}ToeBase>{Left}Foot""",
    "miku miku dance": """
        @hips:全ての親 @hips:センター>全ての親 @hips:グルーブ>センター hips:腰>グルーブ spine:上半身>腰
        spine:上半身2>上半身 neck:首>上半身2 head:頭>首 @head:{左}目>頭 @hips:下半身>腰 @clavicle:{左}肩P>上半身2
        clavicle:{左}肩>{左}肩P
        @clavicle:{左}肩C>{左}肩 upper_arm:{左}腕>{左}肩C @lower_arm:{左}腕捩>{左}腕 lower_arm:{左}ひじ>{左}腕捩
        @hand:{左}手捩>{左}ひじ hand:{左}手首>{左}手捩 @hand:{左}親指０>{左}手首 @hand:{左}中指１>{左}手首
        thigh:{左}足>下半身 shin:{左}ひざ>{左}足 foot:{左}足首>{左}ひざ toe:{左}つま先>{左}足首
        @thigh:{左}足D>下半身 @shin:{左}ひざD>{左}足D @foot:{左}足ＩＫ>全ての親 @toe:{左}つま先ＩＫ>{左}足ＩＫ""",
    "miku miku dance, half-width": """
        hips:センター spine:上半身>センター neck:首>上半身 head:頭>首 @hips:下半身>センター clavicle:{左}肩>上半身
        upper_arm:{左}腕>{左}肩 lower_arm:{左}ひじ>{左}腕 hand:{左}手首>{左}ひじ thigh:{左}足>下半身
        shin:{左}ひざ>{左}足 foot:{左}足首>{左}ひざ @foot:{左}足IK>センター""",
    "chinese": """
        hips:骨盆 spine:脊椎1>骨盆 spine:脊椎2>脊椎1 neck:脖子>脊椎2 head:头部>脖子 clavicle:{左}锁骨>脊椎2
        upper_arm:{左}上臂>{左}锁骨 lower_arm:{左}前臂>{左}上臂 hand:{左}手>{左}前臂 thigh:{左}大腿>骨盆
        shin:{左}小腿>{左}大腿 foot:{左}脚>{左}小腿 toe:{左}脚趾>{左}脚""",
    "korean": """
        hips:골반 spine:척추>골반 neck:목>척추 head:머리>목 clavicle:{왼}쪽어깨>척추 upper_arm:{왼}쪽위팔>{왼}쪽어깨
        lower_arm:{왼}쪽팔꿈치>{왼}쪽위팔 hand:{왼}쪽손목>{왼}쪽팔꿈치 thigh:{왼}쪽허벅지>골반
        shin:{왼}쪽무릎>{왼}쪽허벅지 foot:{왼}쪽발목>{왼}쪽무릎 toe:{왼}쪽발가락>{왼}쪽발목""",
    "german": """
        hips:Hüfte spine:Wirbelsäule>Hüfte spine:Brust>Wirbelsäule neck:Hals>Brust head:Kopf>Hals
        clavicle:Schulter_{L}>Brust upper_arm:Oberarm_{L}>Schulter_{L} lower_arm:Unterarm_{L}>Oberarm_{L}
        hand:Hand_{L}>Unterarm_{L} thigh:Oberschenkel_{L}>Hüfte shin:Unterschenkel_{L}>Oberschenkel_{L}
        foot:Fuß_{L}>Unterschenkel_{L} toe:Zehen_{L}>Fuß_{L}""",
    "german, in words": """
        hips:Becken spine:Ruecken>Becken neck:Nacken>Ruecken head:Kopf>Nacken clavicle:{Linke}sSchluesselbein>Ruecken
        upper_arm:{Linke}rOberarm>{Linke}sSchluesselbein lower_arm:{Linke}rEllbogen>{Linke}rOberarm
        hand:{Linke}sHandgelenk>{Linke}rEllbogen thigh:{Linke}rOberschenkel>Becken
        shin:{Linke}sKnie>{Linke}rOberschenkel foot:{Linke}rFuss>{Linke}sKnie""",
    "french": """
        hips:Bassin spine:Colonne1>Bassin spine:Colonne2>Colonne1 neck:Cou>Colonne2 head:Tête>Cou
        clavicle:Épaule_{G}>Colonne2 upper_arm:Bras_{G}>Épaule_{G} lower_arm:AvantBras_{G}>Bras_{G}
        hand:Main_{G}>AvantBras_{G} thigh:Cuisse_{G}>Bassin shin:Genou_{G}>Cuisse_{G} foot:Pied_{G}>Genou_{G}
        toe:Orteils_{G}>Pied_{G}""",
    "french, in words": """
        hips:Hanches spine:Torse>Hanches neck:Cou>Torse head:Tete>Cou clavicle:Clavicule{Gauche}>Torse
        upper_arm:Bras{Gauche}>Clavicule{Gauche} lower_arm:Coude{Gauche}>Bras{Gauche}
        hand:Poignet{Gauche}>Coude{Gauche} thigh:Cuisse{Gauche}>Hanches shin:Jambe{Gauche}>Cuisse{Gauche}
        foot:Cheville{Gauche}>Jambe{Gauche}""",
    "spanish": """
        hips:Cadera spine:Columna>Cadera spine:Pecho>Columna neck:Cuello>Pecho head:Cabeza>Cuello
        clavicle:Hombro{Izq}>Pecho upper_arm:Brazo{Izq}>Hombro{Izq} lower_arm:Antebrazo{Izq}>Brazo{Izq}
        hand:Mano{Izq}>Antebrazo{Izq} thigh:Muslo{Izq}>Cadera shin:Pierna{Izq}>Muslo{Izq} foot:Pie{Izq}>Pierna{Izq}""",
    "italian": """
        hips:Bacino spine:Schiena>Bacino spine:Torace>Schiena neck:Collo>Torace head:Testa>Collo
        clavicle:spalla_{sx}>Torace upper_arm:braccio_{sx}>spalla_{sx} lower_arm:avambraccio_{sx}>braccio_{sx}
        hand:mano_{sx}>avambraccio_{sx} thigh:coscia_{sx}>Bacino shin:gamba_{sx}>coscia_{sx}
        foot:piede_{sx}>gamba_{sx}""",
    "portuguese": """
        hips:Quadril spine:Coluna>Quadril neck:Pescoço>Coluna head:Cabeça>Pescoço clavicle:Ombro_{L}>Coluna
        upper_arm:Braço_{L}>Ombro_{L} lower_arm:Antebraço_{L}>Braço_{L} hand:Mão_{L}>Antebraço_{L}
        thigh:Coxa_{L}>Quadril shin:Joelho_{L}>Coxa_{L} foot:Pé_{L}>Joelho_{L}""",
}
MARKS = {
    "{L}": "LR",
    "{l}": "lr",
    "{Left}": ("Left", "Right"),
    "{LEFT}": ("LEFT", "RIGHT"),
    "{左}": "左右",
    "{왼}": ("왼", "오른"),
    "{Linke}": ("Linke", "Rechte"),
    "{G}": "GD",
    "{Gauche}": ("Gauche", "Droite"),
    "{Izq}": ("Izq", "Der"),
    "{sx}": ("sx", "dx"),
}


def rig(text: str):
    """The skeleton of a convention, and bone -> joint names that its map must have."""
    places: dict[str, Place] = {}
    rows: list[tuple[str, str, Place]] = []
    found: dict = dict.fromkeys(BONES)
    chains: dict[str, list[str]] = {"spine": [], "neck": []}
    mark = next(mark for mark in MARKS if mark in text)
    joints = [joint for joint in text.split()]
    for side, sign, word in (("left", 1.0, MARKS[mark][0]), ("right", -1.0, MARKS[mark][1])):
        for joint in joints:
            bone, _, link = joint.replace(mark, word).partition(":")
            name, _, parent = link.partition(">")
            if name in places:
                continue
            part = bone.lstrip("@")
            if part in ("spine", "neck"):
                chains[part].append(name)
                base, step = (1.0, 0.08) if part == "spine" else (1.46, 0.05)
                place = (0.0, base + step * len(chains[part]), 0.0)
            elif part in TRUNK:
                place, found[part] = TRUNK[part], found[part] if bone != part else name
            else:
                x, y, z = LIMBS[part]
                place = (sign * x, y, z)
                if bone == part:
                    found[f"{side}_{part}"] = name
            if bone != part:
                place = (place[0], place[1] - 0.02, place[2] + 0.03)
            places[name] = place
            x, y, z = np.subtract(place, places[parent] if parent else place).tolist()
            rows.append((name, parent, (x, y, z)))
    return tree(rows), found | chains


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_naming_conventions(convention):
    skeleton, expected = rig(CONVENTIONS[convention])
    humanoid = find_humanoid(skeleton)
    assert humanoid.names(skeleton.names) == expected
    if humanoid.left_toe is not None:
        assert humanoid.confidence == 1.0  # toes confirm left and right
    mirror = find_mirror(skeleton, humanoid)
    assert all(
        mirror[joint] == other
        for bone, joint in humanoid.joints().items()
        if bone.startswith("left_") and isinstance(other := humanoid.joints()[bone.replace("left", "right")], int)
    )


@pytest.mark.parametrize("convention", ["miku miku dance", "chinese", "korean", "german", "french"])
def test_geometry_confirms_names_of_any_language(convention):
    """Names with the sides exchanged are doubtful."""
    skeleton, _ = rig(CONVENTIONS[convention])
    flipped = replace(skeleton, offsets=skeleton.offsets * np.array([-1.0, 1.0, 1.0]))
    humanoid = find_humanoid(flipped)
    assert humanoid.confidence < 1.0 and any("doubtful" in line for line in humanoid.explanation)
