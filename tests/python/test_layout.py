"""Tests that the package's structs, enumerations and functions match sherf.h as the C compiler sees it."""

import ctypes
import re
import subprocess
import tempfile
import unittest
from pathlib import Path

from sherf import _library, avatars, errors

HEADER = Path(__file__).resolve().parents[2] / "include"
ENUMERATIONS = {"SHERF_PRECISION": _library.PRECISIONS, "SHERF_DEVICE": _library.DEVICES,
                "SHERF_ROTATIONS": _library.ROTATIONS, "SHERF_ROOT": _library.ROOTS,
                "SHERF_CAMERA": _library.CAMERA_PATHS}


def numbers_of_c(expressions):
    """The values of these expressions in C."""
    lines = "".join(f'printf("%lld\\n", (long long)({e}));' for e in expressions)
    program = f'#include <sherf/sherf.h>\n#include <stdio.h>\nint main(void) {{{lines} return 0;}}\n'
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["cc", "-x", "c", "-", "-I", HEADER, "-o", folder + "/a"], input=program, text=True, check=True)
        return [int(x) for x in
                subprocess.run([folder + "/a"], capture_output=True, text=True, check=True).stdout.split()]


class TestLayout(unittest.TestCase):
    def test_structs(self):
        wanted = {}
        for name, struct in _library.STRUCTS.items():
            wanted[f"sizeof({name})"] = ctypes.sizeof(struct)
            for field, *_ in struct._fields_:
                wanted[f"offsetof({name}, {field})"] = getattr(struct, field).offset
                wanted[f"sizeof((({name} *)0)->{field})"] = getattr(struct, field).size
        self.assertEqual(dict(zip(wanted, numbers_of_c(wanted))), wanted)

    def test_enumerations(self):
        wanted = {"SHERF_PICTURES_MAX": avatars.PICTURES_MAX, "SHERF_UP_MINUS_Y": _library.UPS.index("-y"),
                  "SHERF_UP_Z": _library.UPS.index("z")}
        for prefix, names in ENUMERATIONS.items():
            wanted.update({f"{prefix}_{n.upper().replace('-', '_')}": i for i, n in enumerate(names)})
        wanted.update({f"SHERF_ESTIMATE_{n.upper()}": 1 << i for i, n in enumerate(_library.WARNINGS)})
        wanted.update({"SHERF_" + re.sub("(?<!^)([A-Z])", r"_\1", e.__name__).upper(): i
                       for i, e in enumerate(errors.BY_STATUS) if e})
        self.assertEqual(dict(zip(wanted, numbers_of_c(wanted))), wanted)

    def test_functions(self):
        text = re.sub(r"/\*.*?\*/", "", (HEADER / "sherf/sherf.h").read_text(encoding="utf-8"), flags=re.S)
        declared = dict(re.findall(r"SHERF_API[^;(]*?(sherf_\w+)\s*\(([^;]*)\);", text))
        for name, (_, arguments) in _library.FUNCTIONS.items():
            with self.subTest(name=name):
                inside = declared[name].strip()
                self.assertEqual(len(arguments), 0 if inside == "void" else inside.count(",") + 1)

    def test_version(self):
        self.assertIn(f'#define SHERF_VERSION "{_library.VERSION}"', (HEADER / "sherf/sherf.h").read_text("utf-8"))


if __name__ == "__main__":
    unittest.main()
