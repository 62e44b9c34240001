"""Turns joint names in other scripts into English words, such as 左足首 of MikuMikuDance into `left ankle`."""

from __future__ import annotations

import unicodedata

_JAPANESE = {
    "左": "left",
    "右": "right",
    "腰": "hips",
    "骨盤": "pelvis",
    "上半身": "upper body",
    "下半身": "lower body",
    "背骨": "spine",
    "胸": "chest",
    "首": "neck",
    "頭": "head",
    "鎖骨": "clavicle",
    "肩": "shoulder",
    "上腕": "upper arm",
    "腕": "arm",
    "前腕": "forearm",
    "ひじ": "elbow",
    "肘": "elbow",
    "手首": "wrist",
    "手": "hand",
    "太もも": "thigh",
    "もも": "thigh",
    "大腿": "thigh",
    "足": "leg",
    "ひざ": "knee",
    "膝": "knee",
    "すね": "shin",
    "足首": "ankle",
    "つま先": "toe",
    "爪先": "toe",
    "捩": "twist",
    "捻": "twist",
    "先": "tip",
    "親": "root",
    "指": "finger",
}
_CHINESE = {
    "骨盆": "pelvis",
    "臀部": "hips",
    "脊柱": "spine",
    "脊椎": "spine",
    "胸部": "chest",
    "颈": "neck",
    "脖子": "neck",
    "头": "head",
    "锁骨": "clavicle",
    "上臂": "upper arm",
    "大臂": "upper arm",
    "前臂": "forearm",
    "小臂": "forearm",
    "手腕": "wrist",
    "小腿": "calf",
    "脚踝": "ankle",
    "脚": "foot",
    "脚趾": "toe",
}
_KOREAN = {
    "왼쪽": "left",
    "왼": "left",
    "오른쪽": "right",
    "오른": "right",
    "골반": "pelvis",
    "엉덩이": "hips",
    "척추": "spine",
    "가슴": "chest",
    "목": "neck",
    "머리": "head",
    "쇄골": "clavicle",
    "어깨": "shoulder",
    "위팔": "upper arm",
    "팔": "arm",
    "아래팔": "forearm",
    "팔꿈치": "elbow",
    "손목": "wrist",
    "손": "hand",
    "허벅지": "thigh",
    "무릎": "knee",
    "종아리": "calf",
    "발목": "ankle",
    "발": "foot",
    "발가락": "toe",
    "손가락": "finger",
}
WORDS = {**_JAPANESE, **_CHINESE, **_KOREAN}
"""Words of Japanese, Chinese and Korean, which need no spaces between them -> English."""

_LONGEST_FIRST = sorted(WORDS, key=lambda word: -len(word))


def in_english(name: str) -> str:
    """Returns a name with words of other scripts in English, and letters without accents; other characters are kept.

    Args:
        name: of a joint, in any script. Names in ASCII are returned unchanged.
    """
    if name.isascii():
        return name
    name = unicodedata.normalize("NFKC", name)  # wide letters and digits
    for word in _LONGEST_FIRST:
        if word in name:
            name = name.replace(word, f" {WORDS[word]} ")
    name = name.replace("ß", "ss")
    return "".join(letter for letter in unicodedata.normalize("NFKD", name) if not unicodedata.combining(letter))
