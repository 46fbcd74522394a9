"""People who were modelled by MakeHuman, as they are filmed: drawn at three times the size before a mottled
background, lit from one side, with noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from shared.filming import Studio, lamp_at, taken, triangulated, write_film
from shared.inputs import truth_of
from shared.makehuman import MakeHuman, draw

from mien.arrays import Array, Float32, Pixels
from mien.geometry.rotation import FACING, matrix_from_euler

SUPERSAMPLING = 3
CENTIMETRES = 10.0
"""Of one of MakeHuman's units."""
EYES_APART = 0.6
"""Distance of a grown person's eyes, in these units: children are filmed from so near that theirs are as far apart."""
FROM_EYES = (0.0, -0.25, -0.75)
"""From the middle of the eyes to the origin of the head's axes, between the ears, in MakeHuman's units."""
LENS_TINT = 0.15
"""Share of the lenses' tint that is left: MakeHuman's are dark."""
PROFILE = ((1114, 7806), (72, 6856), (294, 294), (343, 343), (5347, 11949), (3733, 10401), (466, 466), (492, 492))
IBUG_PROFILE = ((36, 45), (39, 42), (30, 30), (33, 33), (31, 35), (48, 54), (51, 51), (57, 57))
"""Vertices of MakeHuman and points of iBUG, right and left: outer and inner corners of the eyes, tip and base of the
nose, nostrils, corners of the mouth, upper and lower lip. They say how a head stands when it faces the camera."""
SHAPE_SD = 0.35
"""Standard deviation of the weight of each of SHAPES."""
SHAPES = (
    ("head-oval", "head-round"),
    ("head-triangular", "head-invertedtriangular"),
    ("head-scale-depth-more", "head-scale-depth-less"),
    ("head-scale-horiz-more", "head-scale-horiz-less"),
    ("nose-scale-depth-incr", "nose-scale-depth-decr"),
    ("nose-curve-convex", "nose-curve-concave"),
    ("nose-scale-horiz-incr", "nose-scale-horiz-decr"),
    ("chin-prominent-more", "chin-prominent-less"),
    ("chin-prognathism-more", "chin-prognathism-less"),
    ("forehead-nubian-more", "forehead-nubian-less"),
)
"""Targets that make a head its own, the one or its opposite, each with a weight of its own."""
UNITS = {
    "jawOpen": ("mouth-open",),
    "mouthSmile": ("mouth-corner-puller",),
    "mouthFunnel": ("mouth-pursing",),
    "browDown": ("eyebrows-left-down", "eyebrows-right-down"),
    "browInnerUp": ("eyebrows-left-inner-up", "eyebrows-right-inner-up"),
    "browOuterUp": ("eyebrows-left-extern-up", "eyebrows-right-extern-up"),
    "eyeBlink": ("eye-left-closure", "eye-right-closure"),
}
"""MakeHuman's targets for the shapes of the rendered sequences, left and right together."""


@dataclass(frozen=True)
class Character:
    """Who somebody is, in the names of MakeHuman's files."""

    ethnicity: str
    sex: str
    age: str
    brows: str
    hair: str | None
    beard: str | None = None
    spectacles: bool = False


PEOPLE = {
    "young": Character("caucasian", "male", "young", "eyebrow001", "short02"),
    "bearded": Character("caucasian", "male", "old", "eyebrow007", "short01", beard="Full_beard"),
    "student": Character("asian", "female", "young", "eyebrow003", "ponytail01", spectacles=True),
    "teacher": Character("african", "male", "young", "eyebrow009", "short04", spectacles=True),
    "mother": Character("african", "female", "young", "eyebrow004", "afro01"),
    "grandmother": Character("caucasian", "female", "old", "eyebrow010", "curly2", spectacles=True),
}

CHILDREN = {
    "infant": Character("caucasian", "male", "baby", "eyebrow001", None),
    "toddler": Character("african", "female", "baby", "eyebrow004", "short02"),
    "girl": Character("asian", "female", "child", "eyebrow003", "ponytail01"),
    "boy": Character("caucasian", "male", "child", "eyebrow001", "short02"),
}


def named(people: Mapping[str, Character] = PEOPLE) -> list[tuple[str, Character, bool, int]]:
    """All of these people, and whoever wears spectacles once more without them: a name, the character, whether they
    are worn, and the seed of the shape."""
    worn = [(name, who, who.spectacles, seed) for seed, (name, who) in enumerate(people.items())]
    return worn + [(f"{name}-bare", who, False, seed) for name, who, spectacles, seed in worn if spectacles]


class Person:
    """A character with a body (V, 3) of its own and what covers it; origin (3,), axes (3, 3): of its head; centimetres:
    of one of MakeHuman's units."""

    def __init__(
        self, source: MakeHuman, who: Character, profile: Array, rng: np.random.Generator, spectacles: bool
    ) -> None:
        """profile: of `rendered_profile`."""
        self.body = source.body + source.target(f"macrodetails/{who.ethnicity}-{who.sex}-{who.age}")
        grown = who.age in ("young", "old")
        if not grown:
            self.body += source.target(f"macrodetails/universal-{who.sex}-{who.age}-averagemuscle-averageweight")
        for weight, (more, less) in zip(rng.normal(0, SHAPE_SD, len(SHAPES)), SHAPES, strict=True):
            shape = more if weight > 0 else less
            self.body = self.body + abs(weight) * source.target(f"{shape.split('-')[0]}/{shape}")
        self.shapes = {
            shape: np.sum([source.target(f"expression/units/{who.ethnicity}/{unit}") for unit in units], axis=0)
            for shape, units in UNITS.items()
        }
        eyes = source.proxy("eyes/Low-Poly", f"textures/{'blue' if who.ethnicity == 'caucasian' else 'brown'}_eye.png")
        self.parts = [
            source.skin(f"{who.age if grown else 'young'}_{who.ethnicity}_{who.sex}"),
            eyes,
            source.proxy("teeth/Teeth_Base"),
            source.proxy(f"eyebrows/{who.brows}"),
        ]
        self.parts += [source.proxy(f"hair/{grows}") for grows in (who.hair, who.beard) if grows]
        if spectacles:
            worn = source.proxy("clothes/glasses")
            opacity = worn.texture[:, :, 3]
            opacity[opacity < 250] *= LENS_TINT
            self.parts.append(worn)
        pupils = eyes.vertices(self.body)
        left = pupils[:, 0] > 0
        apart = np.linalg.norm(pupils[left].mean(axis=0) - pupils[~left].mean(axis=0))
        self.centimetres = CENTIMETRES if grown else CENTIMETRES * EYES_APART / apart
        self.origin = pupils.mean(axis=0) + np.array(FROM_EYES) * CENTIMETRES / self.centimetres
        self.axes = upright(self.body[np.array(PROFILE)].mean(axis=1)[:, 1:], profile)

    def picture(self, weights: dict[str, float], R: Array, t: Array, lamp: Array, studio: Studio) -> Float32:
        """The person (H, W, 3) with an expression, weights of UNITS, at a pose."""
        body = self.body + sum(weight * self.shapes[shape] for shape, weight in weights.items())
        image, depth = studio.background.copy(), np.full(studio.background.shape[:2], np.inf, np.float32)
        for part in self.parts:
            X = (part.vertices(body) - self.origin) * self.centimetres
            draw(part, X @ (R @ self.axes).T + t, lamp, studio.camera, image, depth)
        return image


def rendered_profile(path: Path) -> Array:
    """(k, 2) y and z of IBUG_PROFILE in the head's axes, mean of the three rendered people."""
    found = []
    for name in "ace":
        truth = truth_of(path, f"{name}_uniform1")
        head = triangulated(truth["landmarks68"].astype(float), FACING @ truth["R"], truth["t"])
        side = head[np.array(IBUG_PROFILE)].mean(axis=1)[:, 1:]
        found.append(side - side.mean(axis=0))
    return np.asarray(np.mean(found, axis=0))


def upright(profile: Array, rendered: Array) -> Array:
    """Rotation (3, 3) about x that brings one profile (k, 2), y and z, nearest to another, whatever their sizes."""
    p, q = ((side - side.mean(axis=0)) @ [1, 1j] for side in (profile, rendered))
    return matrix_from_euler(np.array([np.angle((q * p.conj()).sum()), 0.0, 0.0]))


def pictures(person: Person, truth: dict[str, Array], swinging: bool, rng: np.random.Generator) -> Iterator[Pixels]:
    """The person in the motion and expression of a rendered sequence."""
    studio = Studio.build(SUPERSAMPLING, rng)
    sides = [str(name).split("_")[0] for name in truth["expression_names"]]
    for k, (R, t) in enumerate(zip(FACING @ truth["R"], truth["t"], strict=True)):
        weights = {shape: float(truth["expression"][k, [side == shape for side in sides]].mean()) for shape in UNITS}
        yield taken(person.picture(weights, R, t, lamp_at(k if swinging else 0), studio), rng)


def film(output: Path, person: Person, truth: dict[str, Array], swinging: bool, rng: np.random.Generator) -> None:
    """Write what `pictures` gives as OUTPUT.avi, and then its truth."""
    write_film(Path(f"{output}.avi"), pictures(person, truth, swinging, rng))
    np.savez(f"{output}_truth.npz", **{key: truth[key] for key in truth if key != "landmarks68"})
