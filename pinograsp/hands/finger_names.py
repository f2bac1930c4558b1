"""What people call the fingers of a hand: from words and abbreviations in the names that its file gives."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from pinograsp.hands.tree import Part, tip_of

# Other names that a file gives, by kind ("motor", "site", "geom"): for a joint or a link those that belong to it.
Labels: TypeAlias = Mapping[str, Mapping[str, Sequence[str]]]

# What people call fingers, by the words for them in files.
_WORDS = {
    "thumb": "thumb",
    "trumb": "thumb",  # in Linker's files
    "index": "index",
    "forefinger": "index",
    "pointer": "index",
    "middle": "middle",
    "medium": "middle",
    "ring": "ring",
    "little": "little",
    "pinky": "pinky",
    "pinkie": "pinky",
}
_AFTER = "finger|knuckle|base|hub|metacarpal|proximal|middle|intermediate|distal|tip|j|l|link|joint"
# Abbreviations, which are words for fingers only among others of them: "rf" may be a right finger, "l" a left one.
_CODES = {
    "th": "thumb",
    "thb": "thumb",
    "thm": "thumb",
    "ff": "index",
    "if": "index",
    "idx": "index",
    "ind": "index",
    "mf": "middle",
    "mid": "middle",
    "rf": "ring",
    "rng": "ring",
    "lf": "little",
    "lit": "little",
    "pf": "pinky",
    "pky": "pinky",
    "pnk": "pinky",
}
_LETTERS = {"t": "thumb", "i": "index", "m": "middle", "r": "ring", "l": "little", "p": "pinky"}
_AFTER_LETTERS = "j|joint|finger|mcp|pip|dip|cmc|abd|rot|flex"  # not "ip": a tip is not the thumb's
_AFTER_CODES = f"{_AFTER}|{_AFTER_LETTERS}|ip"
_TELLING = {"thumb", "index", "middle"}  # two of them make the others fingers as well
_SIDES = {"left": "left", "lh": "left", "right": "right", "rh": "right"}


def name_fingers(chains: list[list[Part]], labels: Labels) -> list[str]:
    """What people call the fingers, where all joints or links say so, or some and none says another, or abbreviations
    do, or else motors, sites or shapes; of two hands with the side before it, also beside legs and a head. Where
    nothing says so: what is the finger's own in the common prefix of its links, if that tells the fingers apart, or
    the fingertip's name.
    """
    for words in _guesses(chains, labels):
        if words and all(words):
            if len(set(words)) == len(words):
                return words
            sided = [f"{_side(chain)}_{word}" for chain, word in zip(chains, words)]
            if len(set(sided)) == len(sided) and all(map(_side, chains)):
                return sided
    names = _own_parts(_prefixes(chains)) if len(chains) > 1 else _prefixes(chains)
    words = _tell_apart([_only_word(one, _WORDS) for one in _together(chains)]) or [""] * len(chains)
    sides = [_side(chain) for chain in chains]
    told = [f"{side}_{word}" if word else name for side, word, name in zip(sides, words, names)]
    sure = all(side for side, word in zip(sides, words) if word) and len(set(told)) == len(told)
    return told if sure else names


def _guesses(chains: list[list[Part]], labels: Labels) -> Iterator[list[str]]:
    """Yield lists of words for the fingers, the surest first; "" where a finger has none."""
    joints = _own([[part.joint.name for part in chain] for chain in chains])
    links = _own([[part.joint.child for part in chain] for chain in chains])
    tips = [[tip_of(chain)] for chain in chains]
    together = _together(chains)
    yield [_finger_word(chain) for chain in chains]
    yield [_only_word(names, _WORDS) for names in together]
    for names in (joints, links, tips):
        yield from _abbreviate(names)
    yield _tell_apart([_only_word(names, _WORDS | _CODES) for names in together])
    for owned in labels.values():
        names = [[name for one in _owners(chain) for name in owned.get(one, ())] for chain in chains]
        yield [_only_word(one, _WORDS) for one in names]
        yield from _abbreviate(names)


def _together(chains: list[list[Part]]) -> list[list[str]]:
    """Names of the tip, the joints and the links that are a finger's alone."""
    joints = _own([[part.joint.name for part in chain] for chain in chains])
    links = _own([[part.joint.child for part in chain] for chain in chains])
    return [[tip_of(chain), *a, *b] for chain, a, b in zip(chains, joints, links)]


def _own(names: list[list[str]]) -> list[list[str]]:
    """Names without those that chains share, as of a wrist that carries several."""
    shared = {name for name, count in Counter(name for own in names for name in own).items() if count > 1}
    return [[name for name in own if name not in shared] for own in names]


def _owners(chain: list[Part]) -> list[str]:
    """The joints and links of a chain, which other names may belong to."""
    return [name for part in chain for name in dict.fromkeys((part.joint.name, *part.links))]


def _finger_word(chain: list[Part]) -> str:
    """The word for the finger in the name of every link of a chain or of its joint; "" for none or several."""
    common: set[str] | None = None
    for part in chain:
        found = {word for name in (part.joint.name, part.joint.child) for word in _words_in(name, _WORDS)}
        common = found if common is None else common & found
    return next(iter(common)) if common is not None and len(common) == 1 else ""


def _only_word(names: Iterable[str], words: Mapping[str, str]) -> str:
    """The one word for a finger in names that belong to it; a finger's middle part is none."""
    found = {word for name in names for word in _words_in(name, words)}
    if len(found) > 1:
        found.discard("middle")
    if found == {"little", "pinky"}:  # the same one
        found.discard("little")
    return next(iter(found)) if len(found) == 1 else ""


def _abbreviate(names: list[list[str]]) -> Iterator[list[str]]:
    """Yield the words for the fingers that stand at the same place of all their names, counted from either end."""
    split = [[_tokens(name) for name in own] for own in names]
    if not all(split) or not split:
        return
    shortest = min(len(tokens) for own in split for tokens in own)
    for place in (*range(shortest), *range(-shortest, 0)):
        found = [{_code(tokens[place]) for tokens in own} for own in split]
        yield _tell_apart([one.pop() if len(one) == 1 else "" for one in found])


def _tell_apart(words: list[str]) -> list[str]:
    """The words where they are those of a hand; else none."""
    return words if len(_TELLING.intersection(words)) > 1 else []


def _code(token: str) -> str:
    """The finger that a part of a name is a word, an abbreviation or a letter for; "" for none."""
    for words, after in ((_WORDS, _AFTER), (_CODES, _AFTER_CODES), (_LETTERS, _AFTER_LETTERS)):
        for word in words:
            if re.fullmatch(rf"{word}({after})?", token):
                return words[word]
    return ""


def _words_in(name: str, words: Mapping[str, str]) -> list[str]:
    """The fingers whose words are in a name: parts between signs, digits and capitals, or their beginnings."""
    return [words[word] for part in _tokens(name) for word in words if re.fullmatch(rf"{word}({_AFTER})?", part)]


def _tokens(name: str) -> list[str]:
    """Parts of a name between signs, digits and capitals, in lower case."""
    return [part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]


def _side(chain: list[Part]) -> str:
    """The hand that a finger is of: "left", "right", or "" where its names do not say; the outermost that do count,
    since a torso may carry a left camera.
    """
    for part in reversed(chain):
        names = (part.joint.name, *part.links)
        found = {_SIDES[token] for name in names for token in _tokens(name) if token in _SIDES}
        if len(found) == 1:
            return next(iter(found))
    return ""


def _own_parts(names: list[str]) -> list[str]:
    """Names without the parts that all of them have at the beginning or at the end, where what is left is a name."""
    parts = [re.split(r"[_\-./: ]+", name) for name in names]
    while len({one[0] for one in parts}) == 1 and min(map(len, parts)) > 1:
        parts = [one[1:] for one in parts]
    while len({one[-1] for one in parts}) == 1 and min(map(len, parts)) > 1:
        parts = [one[:-1] for one in parts]
    short = ["_".join(one) for one in parts]
    if all(name.lower().endswith("finger") and len(name) > len("finger") for name in short):
        short = [name[: -len("finger")].rstrip("_") for name in short]
    if all(name.isdigit() for name in short):
        short = [f"finger {name}" for name in short]
    return short if all(short) and len(set(short)) == len(short) else names


def _prefixes(chains: list[list[Part]]) -> list[str]:
    """The common prefix of each finger's links, where that tells the fingers apart; else the fingertip's name."""
    prefixes = [_common_start([*(part.joint.child for part in chain), tip_of(chain)]) for chain in chains]
    for ending in ("_-. 0123456789", "_-. "):
        names = [prefix.rstrip(ending) for prefix in prefixes]
        if all(names) and len(set(names)) == len(names):
            return names
    return [tip_of(chain) for chain in chains]


def _common_start(texts: list[str]) -> str:
    start = texts[0]
    while not all(text.startswith(start) for text in texts):
        start = start[:-1]
    return start
