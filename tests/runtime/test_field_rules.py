"""The table of ranges, constants and NaN agrees with the .lcm files."""

import re
from pathlib import Path

import pytest

from downbeat import lcm_types
from downbeat.runtime.codec_layout import known_types, layout_of
from downbeat.runtime.field_rules import ENUMERATIONS, NAN_ALLOWED, RANGES, UNIT_QUATERNIONS

TYPES = known_types()
LCM_FILES = Path(lcm_types.__file__).parent


@pytest.mark.parametrize("key", [*RANGES, *NAN_ALLOWED, *ENUMERATIONS, *UNIT_QUATERNIONS])
def test_every_rule_is_about_a_field_that_exists(key):
    name, field = key.split(".")
    assert field in TYPES[name].__slots__


def test_nan_is_allowed_exactly_where_the_documentation_says_so():
    documented = set()
    for path in LCM_FILES.glob("*_t.lcm"):
        comment = ""
        for line in path.read_text().splitlines():
            declared = re.match(r"\s+[\w.]+\s+(\w+)(\[\w+\])?;\s*$", line)
            if declared and "NaN" in comment:
                documented.add(f"{path.stem}.{declared.group(1)}")
            comment = line if line.strip().startswith("//") else ""
    assert documented == set(NAN_ALLOWED)


def test_every_enumeration_names_all_constants_that_its_type_declares():
    for name, cls in TYPES.items():
        declared = {c for c in vars(cls) if c.isupper() and not c.startswith("_")}
        named = {c for owner, names in ENUMERATIONS.values() if owner == name for c in names}
        assert declared == named, name


def test_every_enumeration_rule_has_at_least_two_constants():
    for key in ENUMERATIONS:
        name, field = key.split(".")
        (leaf,) = (leaf for leaf in layout_of(TYPES[name]).leaves if leaf.path == (field,))
        assert leaf.rule.constants is not None and len(leaf.rule.constants) >= 2
