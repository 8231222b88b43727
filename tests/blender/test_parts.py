"""Tests the parts of the Blender add-on that need no Blender: python3 tests/blender/test_parts.py"""
import importlib.util
import json
import math
import os
import random
import re
import stat
import struct
import subprocess
import sys
import tempfile
import time
import types
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def part(name):
    """Loads blender/NAME.py as a module of a package without the package's own __init__, which needs Blender."""
    if "sherf_addon" not in sys.modules:
        package = types.ModuleType("sherf_addon")
        package.__path__ = [os.path.join(ROOT, "blender")]
        sys.modules["sherf_addon"] = package
    return importlib.import_module("sherf_addon." + name)


program, motion, glb = part("program"), part("motion"), part("glb")
Failure = program.Failure


def script(folder, name, text):
    """Writes a program that is a few lines of shell."""
    path = os.path.join(folder, name)
    with open(path, "w", encoding="utf-8") as f:
        f.write("#!/bin/sh\n" + text)
    os.chmod(path, stat.S_IRWXU)
    return path


class Folder(unittest.TestCase):
    def setUp(self):
        self.room = tempfile.TemporaryDirectory(prefix="sherf ünï ")
        self.folder = self.room.name

    def tearDown(self):
        self.room.cleanup()

    def path(self, name, data=b""):
        with open(os.path.join(self.folder, name), "wb") as f:
            f.write(data)
        return os.path.join(self.folder, name)


class Finding(Folder):
    def test_places(self):
        before, home = os.environ["PATH"], os.environ.get("HOME", "")
        os.environ["PATH"] = os.environ["HOME"] = self.folder
        try:
            if not any(map(os.path.exists, ("/usr/local/bin/sherf", "/opt/sherf/bin/sherf"))):
                with self.assertRaisesRegex(Failure, "not found.*preferences"):
                    program.find_program(folder=self.folder)
            os.mkdir(os.path.join(self.folder, "bin"))
            beside = script(self.folder, "bin/sherf", "")
            self.assertEqual(program.find_program(folder=self.folder), beside)
            on_path = script(self.folder, "sherf", "")
            self.assertEqual(program.find_program(folder="/nowhere"), on_path)
            self.assertEqual(program.find_program(beside), beside)
            with self.assertRaisesRegex(Failure, "none: no such program"):
                program.find_program(os.path.join(self.folder, "none"))
            with self.assertRaises(Failure):
                program.find_program(self.folder)
        finally:
            os.environ["PATH"], os.environ["HOME"] = before, home

    def test_kinds(self):
        for name, kind in (("a b.JPG", "photo"), ("ä.heic", "photo"), ("x.glb", "glb"), ("x.safetensors", "avatar")):
            self.assertEqual(program.kind_of(self.path(name)), kind)
        self.assertEqual(program.kind_of(self.folder), "photo")
        with self.assertRaisesRegex(Failure, "neither an avatar"):
            program.kind_of(self.path("x.txt"))
        with self.assertRaisesRegex(Failure, "no such file"):
            program.kind_of(os.path.join(self.folder, "none.jpg"))

    def test_names(self):
        self.assertTrue(program.free_name(self.folder, "me", ".x").endswith("/me.x"))
        self.path("me.x")
        self.path("me-2.x")
        self.assertTrue(program.free_name(self.folder, "me", ".x").endswith("/me-3.x"))


class Lines(Folder):
    def test_commands(self):
        words = program.avatar_command("/p/sherf", ["-x.jpg"], "/o.safetensors", person=2)
        self.assertEqual(words[:2] + words[5:], ["/p/sherf", "avatar", "--person", "2"])
        self.assertTrue(os.path.isabs(words[2]))  # a file name that begins with - is not an option
        body = self.path("body.safetensors")
        photo = self.path("me.jpg")
        self.assertEqual(program.avatar_command("s", [photo], "o")[-2:], ["--body", body])
        words = program.avatar_command("s", [photo, "/p/-back.png"], "/o")
        self.assertEqual(words[1:5], ["avatar", photo, "/p/-back.png", "--output"])
        self.assertEqual(program.body_words("/b.npz", photo), ["--body", "/b.npz"])
        words = program.export_command("s", "a", "g.glb", "LOW", 512, True, ["--body", "b"])
        self.assertEqual(words[words.index("--resolution") + 1], "128")
        self.assertEqual(words[-4:], ["--pose", "observation", "--body", "b"])
        words = program.motion_command("s", "", "m.bvh", "o.bvh", 23.976, track="-1", first=3, last=9, smooth_s=0.1,
                                       loop=True)
        self.assertEqual(words[2], "--motion")
        for word in ("--track=-1", "--loop", "23.976", "--own-place"):
            self.assertIn(word, words)

    def test_several_photos(self):
        front, back = self.path("front.jpg"), self.path("back.png")
        names = ["back.png", "front.jpg"]
        self.assertEqual(program.photos_of(front, names), [front, back])  # the shown one comes first
        self.assertEqual(program.photos_of(back, names), [back, front])
        self.assertEqual(program.photos_of(front, ["front.jpg"]), [front])
        self.assertEqual(program.photos_of(front, [""]), [front])  # as a script calls it, or with an empty selection
        self.path("me.safetensors")
        with self.assertRaisesRegex(program.Failure, "me.safetensors: no photo"):
            program.photos_of(front, ["front.jpg", "me.safetensors"])
        with self.assertRaisesRegex(program.Failure, "gone.jpg: no such file"):
            program.photos_of(front, ["front.jpg", "gone.jpg"])

    def test_options_are_the_programs(self):
        """Every option used here is in the program's tables."""
        calls = (program.avatar_command("s", ["p", "q"], "a", 1, "b"),
                 program.export_command("s", "a", "g", observed=True),
                 program.video_command("s", "v", "n", 1),
                 program.motion_command("s", "a", "m", "o", 24, ["--body", "b"], "kept", "z", "t", 1, 2, 0.1, True))
        for words in calls:
            text = ""
            for name in ("cmd_" + words[1] + ".c", "photo.h", "shared.h"):
                with open(os.path.join(ROOT, "cli", name), encoding="utf-8") as f:
                    text += f.read()
            for word in words:
                if word.startswith("--"):
                    self.assertIn('"' + word[2:].split("=")[0] + '"', text, words[1])

    def test_what_it_says(self):
        line = program.failure_line
        self.assertEqual(line("density: 4%\nsherf: warning: w\nsherf: a.jpg: nobody was found\n", 1),
                         "a.jpg: nobody was found")
        self.assertEqual(line("sherf export: --texture: 'x' is bad (see 'sherf export --help')\n", 2),
                         "--texture: 'x' is bad")
        self.assertEqual(line("", -9), "the program sherf was ended by signal 9")
        self.assertEqual(line("", 1), "the program sherf failed (status 1)")
        self.assertEqual(program.percent("colours:   3%  1:00 left\ncolours:  78%  0:53 left\n"), ("colours", 78))
        self.assertIsNone(program.percent("body: x, the open body\n"))
        self.assertEqual(program.remarks("sherf: warning: w\n/a.jpg: one person\nother\n", ["/a.jpg"]),
                         (["w"], ["/a.jpg: one person"]))


class Running(Folder):
    def run_all(self, job):
        until = time.monotonic() + 60
        while not job.poll():
            self.assertLess(time.monotonic(), until)
            time.sleep(0.01)

    def test_steps(self):
        ok = script(self.folder, "ok", 'echo "density:  50%  0:01 left" >&2; echo "$1" >"$1"\n')
        job = program.Job()
        job.steps = [("one", [ok, "a b"]), ("two", [ok, "ü"])]
        self.run_all(job)
        self.assertTrue(os.path.exists(job.file("a b")) and os.path.exists(job.file("ü")))
        self.assertIn("two, density 50 %", job.state()[0])
        job.close()
        self.assertFalse(os.path.exists(job.folder))

    def test_failures(self):
        bad = script(self.folder, "bad", "echo 'sherf: x: broken' >&2; exit 1\n")
        for words, said in (([bad], "x: broken"), ([self.folder + "/none"], "cannot be run"), ([bad + "\0"], "run")):
            job = program.Job()
            job.steps = [("it", words)]
            with self.assertRaisesRegex(Failure, said):
                self.run_all(job)
            job.close()

    def test_cancel(self):
        slow = script(self.folder, "slow", "exec sleep 1000\n")
        job = program.Job()
        job.steps = [("it", [slow])]
        self.assertFalse(job.poll())
        process = job.process
        job.close()
        self.assertIsNotNone(process.poll())
        self.assertFalse(os.path.exists(job.folder))


class Glb(Folder):
    def glb(self, g, total=None, size=None):
        text = g if isinstance(g, bytes) else json.dumps(g).encode()
        head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) if total is None else total,
                           len(text) if size is None else size, 0x4E4F534A)
        return self.path("x.glb", head + text)

    def person(self):
        return {"nodes": [{"name": n} for n in motion.NAMES], "skins": [{"joints": list(range(24))}], "meshes": [{}],
                "buffers": [{}]}

    def test_good(self):
        self.assertEqual(len(glb.check(self.glb(self.person()))["nodes"]), 24)

    def test_bad(self):
        other, outside, loose = self.person(), self.person(), self.person()
        other["nodes"][3]["name"] = "hips"
        outside["images"] = [{"uri": "/etc/passwd"}]
        loose["skins"][0]["joints"][5] = 99
        for g, said in ((other, "not a person"), (outside, "another file"), (loose, "no rigged person"),
                        ([], "no object"), (b"{", "JSON"), (b"\xff", "JSON"), ({"skins": 3}, "no rigged"),
                        ({"buffers": [7]}, "no rigged"), (b"[" * 200000, "JSON")):
            with self.assertRaisesRegex(Failure, said):
                glb.check(self.glb(g))
        for path in (self.glb({}, total=5), self.glb({}, size=10 ** 9), self.path("y.glb", b"glTF"),
                     self.path("z.glb", b"hello, this is no binary glTF"), self.folder, self.folder + "/none"):
            with self.assertRaises(Failure):
                glb.check(path)


def chance_turn(rng):
    q = [rng.gauss(0, 1) for _ in range(4)]
    length = math.sqrt(sum(x * x for x in q))
    return tuple(x / length for x in q)


def bvh_of(offsets, pelvis, turns):
    """A BVH as the program writes it, with rotations in the order Z X Y."""
    def joint(j):
        out = [f"{'JOINT' if j else 'ROOT'} {motion.NAMES[j].replace('left_', 'L_').replace('right_', 'R_').title()}",
               "{", "OFFSET " + " ".join(f"{100 * x:.6f}" for x in offsets[j]),
               "CHANNELS " + ("" if j else "6 Xposition Yposition Zposition ") * (not j) +
               ("3 " if j else "") + "Zrotation Xrotation Yrotation"]
        order.append(j)
        children = [k for k in range(24) if motion.PARENTS[k] == j]
        for k in children:
            out += joint(k)
        return out + ([] if children else ["End Site", "{", "OFFSET 0 1 0", "}"]) + ["}"]

    order = []
    lines = ["HIERARCHY"] + joint(0) + ["MOTION", f"Frames: {len(turns)}", "Frame Time: 0.0416666667"]
    for place, turned in zip(pelvis, turns):
        words = [f"{100 * x:.6f}" for x in place]
        for j in order:
            w, x, y, z = turned[j]
            r7 = 2 * (y * z + w * x)
            words += [f"{math.degrees(a):.7f}" for a in (math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)),
                                                         math.asin(max(-1, min(1, r7))),
                                                         math.atan2(2 * (w * y - x * z), 1 - 2 * (x * x + y * y)))]
        lines.append(" ".join(words))
    return "\n".join(lines)


class Motion(unittest.TestCase):
    def setUp(self):
        rng = random.Random(5)
        self.rng = rng
        self.offsets = [tuple(rng.uniform(-0.3, 0.3) for _ in range(3)) if j else (0.0, 0.0, 0.0) for j in range(24)]
        self.pelvis = [tuple(rng.uniform(-1, 1) for _ in range(3)) for _ in range(3)]
        self.turns = [[chance_turn(rng) for _ in range(24)] for _ in range(3)]
        self.clip = motion.Clip(self.offsets, 24, self.pelvis, self.turns)

    def near(self, a, b, within=1e-5):
        self.assertLess(math.dist(a, b), within)

    def test_quaternions(self):
        self.near(motion.rotate(motion.about(2, math.pi / 2), (1, 0, 0)), (0, 1, 0))
        q, v = chance_turn(self.rng), (1.0, 2.0, 3.0)
        self.near(motion.rotate(motion.inverse(q), motion.rotate(q, v)), v)
        self.near(motion.to_blender(motion.rotate(q, v)),
                  motion.rotate(motion.turn_to_blender(q), motion.to_blender(v)))

    def test_bvh(self):
        read = motion.bvh_read(bvh_of(self.offsets, self.pelvis, self.turns))
        self.assertAlmostEqual(read.fps, 24, places=6)
        for frame in range(3):
            for a, b in zip(read.joints(frame), self.clip.joints(frame)):
                self.near(a, b)

    def test_bad_bvh(self):
        text = bvh_of(self.offsets, self.pelvis, self.turns)
        wrong = ["", "HIERARCHY", text[:-40], text.replace("L_Hip", "L_Hup"), text.replace("Frames: 3", "Frames: -3"),
                 text.replace("Frames: 3", "Frames: nan"), text.replace("Zrotation", "Wrotation"), "}" + text,
                 text.replace("OFFSET", "OFFSET x", 1), text.replace("0.0416666667", "0"), text.replace("}", "", 1),
                 text.replace("HIERARCHY", "HIERARCHY }"), text.replace("L_Knee", "L_Hip")]
        for broken in wrong:
            with self.assertRaises(Failure):
                motion.bvh_read(broken)

    def test_onto_a_rig(self):
        """Bones of any orientation, in a T and in another rest pose, put the joints where the motion has them."""
        t_rest = [chance_turn(self.rng) for _ in range(24)]
        for rest_turns in ([motion.IDENTITY] * 24, motion.a_pose()):
            rest = motion.bone_directions(rest_turns, t_rest)
            for frame in range(3):
                turns = motion.bone_turns(self.turns[frame], t_rest, rest)
                at, stand = [], []
                for j, parent in enumerate(motion.PARENTS):
                    if parent < 0:
                        at.append(motion.to_blender(self.pelvis[frame]))
                        stand.append(motion.multiply(rest[j], turns[j]))
                        continue
                    # like Blender: first the rest pose relative to the parent's, then the bone's own rotation
                    local = motion.multiply(motion.inverse(rest[parent]), rest[j])
                    stand.append(motion.multiply(stand[parent], motion.multiply(local, turns[j])))
                    step = motion.rotate(motion.inverse(t_rest[parent]), motion.to_blender(self.offsets[j]))
                    at.append(tuple(a + b for a, b in zip(at[parent], motion.rotate(stand[parent], step))))
                for a, b in zip(at, self.clip.joints(frame)):
                    self.near(a, motion.to_blender(b))

    def test_here(self):
        before = self.clip.joints(2)
        motion.place_here(self.clip)
        self.near((self.clip.pelvis[0][0], self.clip.pelvis[0][2]), (0, 0))
        self.assertAlmostEqual(motion.heading(self.clip.turns[0][0]), 0, places=6)
        after = self.clip.joints(2)
        for j in range(1, 24):  # the whole body is moved
            self.assertAlmostEqual(math.dist(after[0], after[j]), math.dist(before[0], before[j]), places=6)
            self.assertAlmostEqual(after[j][1], before[j][1], places=6)

    def test_legs(self):
        rest = []
        for j, parent in enumerate(motion.PARENTS):
            rest.append(tuple((rest[parent][k] if parent >= 0 else 0) + self.offsets[j][k] for k in range(3)))
        self.assertEqual(motion.fit_legs(self.clip, motion.legs(rest)), 1.0)
        place = self.clip.pelvis[1]
        self.assertAlmostEqual(motion.fit_legs(self.clip, 2 * motion.legs(rest)), 2)
        self.near(self.clip.pelvis[1], tuple(2 * x for x in place))

    def test_signs(self):
        q = chance_turn(self.rng)
        self.assertEqual(motion.nearer(tuple(-x for x in q), q), q)


class Zip(Folder):
    def test_reproducible(self):
        made = []
        for name in ("a.zip", "b.zip"):
            path = os.path.join(self.folder, name)
            subprocess.run([sys.executable, os.path.join(ROOT, "tools/blender_zip.py"), path], check=True,
                           stdout=subprocess.DEVNULL)
            with open(path, "rb") as f:
                made.append(f.read())
        self.assertEqual(made[0], made[1])

    def test_versions(self):
        """The versions of the program, the add-on and the extension are the same."""
        def found(name, pattern):
            with open(os.path.join(ROOT, name), encoding="utf-8") as f:
                return re.search(pattern, f.read()).group(1).replace(", ", ".")
        version = found("CMakeLists.txt", r"VERSION ([0-9]+\.[0-9]+\.[0-9]+)")
        self.assertEqual(found("blender/__init__.py", r'"version": \(([0-9, ]+)\)'), version)
        self.assertEqual(found("blender/blender_manifest.toml", r'\nversion = "([0-9.]+)"'), version)


if __name__ == "__main__":
    unittest.main()
