"""Tests the Python package: from photo to avatar to files; every wrong input raises and nothing crashes."""

import ctypes.util
import gc
import logging
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

import numpy as np

import sherf

ROOT = Path(__file__).resolve().parents[2]
PHOTO = ROOT / "assets/demo/photo.jpg"
SIZE = 64
people = {}


def setUpModule():
    people["body"] = sherf.Body.load()
    people["model"] = sherf.Model.load()
    people["estimator"] = sherf.Estimator.load()
    people["estimate"] = people["estimator"].estimate(PHOTO, people["body"])
    people["avatar"] = sherf.Avatar.from_observation(people["estimate"].observation(), body=people["body"],
                                                     model=people["model"])


def tearDownModule():
    people.clear()


class Folder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)


class TestSeveral(Folder):
    def test_two_photos(self):
        known = {key: people[key] for key in ("body", "model", "estimator")}
        both = sherf.Avatar.from_photos([PHOTO, ROOT / "assets/demo/photo-back.jpg"], **known)
        one = sherf.Avatar.from_photos([PHOTO], **known)
        np.testing.assert_array_equal(one.pose.poses, people["avatar"].pose.poses)
        views = [[avatar.render(camera=camera).color for camera in avatar.orbit(2, size=SIZE)]
                 for avatar in (both, one)]
        self.assertGreater(np.abs(views[0][1] - views[1][1]).mean(), 0.002)  # the back is different
        both.save(self.folder / "both.safetensors")
        sherf.Avatar.load(self.folder / "both.safetensors", people["body"])
        self.assertEqual(one.variant, 0)
        one.variant = 5
        other = [one.render(camera=camera).color for camera in one.orbit(2, size=SIZE)]
        self.assertGreater(np.abs(views[1][1] - other[1]).mean(), 10 * np.abs(views[1][0] - other[0]).mean())
        one.save(self.folder / "one.safetensors")
        self.assertEqual(sherf.Avatar.load(self.folder / "one.safetensors", people["body"]).variant, 5)
        for wrong in (-1, 2**64, 0.5):
            with self.assertRaises((TypeError, ValueError)):
                one.variant = wrong

    def test_what_is_no_list_of_them(self):
        observation = people["estimate"].observation()
        for wrong in ([], [observation] * 9):
            with self.assertRaises(ValueError):
                sherf.Avatar.from_observations(wrong, body=people["body"], model=people["model"])
        for wrong in (observation, [None], [people["body"]]):
            with self.assertRaises(TypeError):
                sherf.Avatar.from_observations(wrong, body=people["body"], model=people["model"], crop=False)
        with self.assertRaises(TypeError):
            sherf.Avatar.from_photos(str(PHOTO))


class TestMissing(Folder):
    def load(self, **environment):
        words = [sys.executable, "-c", "import sherf"]
        kept = {k: v for k, v in os.environ.items() if k != "SHERF_LIBRARY"}
        done = subprocess.run(words, env={**kept, **environment}, capture_output=True, text=True)
        return done.stderr.splitlines()[-1]

    def test_library_that_is_not_there(self):
        said = self.load(SHERF_LIBRARY=str(self.folder / "none.so"))
        for part in ("ImportError", "none.so cannot be loaded", "SHERF_LIBRARY names it", "unset it"):
            self.assertIn(part, said)

    @unittest.skipIf(ctypes.util.find_library("sherf"), "the system has a libsherf")
    def test_no_library_anywhere(self):
        said = self.load()
        for part in ("ImportError", "lib/libsherf.so.0", "libsherf0", "SHERF_LIBRARY"):
            self.assertIn(part, said)


class TestEstimate(Folder):
    def test_arrays_and_facts(self):
        estimate = people["estimate"]
        facts = estimate.facts
        self.assertEqual(estimate.image.shape, (facts.height_px, facts.width_px, 3))
        self.assertEqual(estimate.mask.shape, (facts.height_px, facts.width_px))
        self.assertEqual(facts.people, 1)
        self.assertEqual(facts.warnings, ())
        self.assertGreater(facts.mask_covered, 0.8)

    def test_picture_is_the_photo(self):
        pixels = (sherf.read_image(PHOTO) * 255 + 0.5).astype(np.uint8)
        estimate = people["estimator"].estimate(pixels, people["body"])
        self.assertEqual(estimate.facts.people, 1)
        turned = people["estimator"].estimate(np.asfortranarray(pixels), people["body"])
        np.testing.assert_array_equal(turned.pose.poses, estimate.pose.poses)

    def test_saved_observation(self):
        people["estimate"].save(self.folder / "me")
        people["estimate"].overlay(self.folder / "me.png")
        observation = sherf.Observation.load(self.folder / "me")
        np.testing.assert_allclose(observation.pose.poses, people["estimate"].pose.poses, atol=1e-5)
        self.assertGreater((self.folder / "me.png").stat().st_size, 1000)

    def test_nobody_there(self):
        with self.assertRaises(sherf.Mismatch) as caught:
            people["estimator"].estimate(np.zeros((200, 200, 3), np.uint8), people["body"])
        self.assertIn("nobody", str(caught.exception).lower())


class TestAvatar(Folder):
    def test_frame(self):
        frame = people["avatar"].render(size=(SIZE, 2 * SIZE), background=(1, 1, 1))
        self.assertEqual(frame.color.shape, (2 * SIZE, SIZE, 3))
        self.assertEqual(frame.opacity.shape, frame.depth.shape)
        self.assertEqual(frame.color.dtype, np.float32)
        self.assertGreater(frame.opacity.max(), 0.9)
        self.assertEqual(frame.uint8()[0, 0].tolist(), [255, 255, 255])
        with self.assertRaises(ValueError):
            frame.rgba()

    def test_alpha_and_notebook(self):
        frame = people["avatar"].render(size=SIZE)
        self.assertEqual(frame.uint8(alpha=True).shape, (SIZE, SIZE, 4))
        self.assertTrue(frame._repr_png_().startswith(b"\x89PNG"))

    def test_pose_moves_it(self):
        avatar = people["avatar"]
        pose, camera = avatar.pose, avatar.orbit(size=SIZE)[0]
        still = avatar.render(pose, camera)
        pose.poses[16] = (0, 0, 0.5)
        moved = avatar.render(pose, camera)
        self.assertGreater(np.abs(moved.color - still.color).max(), 0.1)

    def test_saved_and_loaded_is_the_same(self):
        avatar = people["avatar"]
        avatar.save(self.folder / "me.safetensors")
        again = sherf.Avatar.load(self.folder / "me.safetensors", people["body"])
        camera = avatar.orbit(size=SIZE)[0]
        np.testing.assert_array_equal(again.render(camera=camera).color, avatar.render(camera=camera).color)
        self.assertIn("avatar", sherf.info(self.folder / "me.safetensors"))

    def test_observation_of_arrays(self):
        estimate = people["estimate"]
        observation = sherf.Observation.create(estimate.image, estimate.mask > 0.5, estimate.camera, estimate.pose)
        cut = observation.crop(people["model"], people["body"])
        self.assertLess(cut.image.shape[0], observation.image.shape[0])

    def test_export_and_motion(self):
        motion = sherf.Motion.load(self.walk(), start=people["avatar"].pose, body=people["body"])
        self.assertEqual(len(list(motion)), len(motion))
        facts = people["avatar"].export(self.folder / "me.glb", motion=motion, resolution=48, triangles=1000,
                                        texture_px=64)
        self.assertLessEqual(facts.triangles, 1000)
        self.assertEqual((self.folder / "me.glb").read_bytes()[:4], b"glTF")
        frames = list(people["avatar"].frames(motion, size=(48, 48)))
        self.assertEqual(len(frames), len(motion))
        self.assertEqual(people["avatar"].animate(motion, self.folder / "me.gif", size=(48, 48)).frames, len(motion))

    def test_baked(self):
        baked = people["avatar"].bake(resolution=48, triangles=2000, texture_px=64)
        frame = baked.render(size=64)
        self.assertGreater((frame.opacity == 1).sum(), 200)
        baked.save(self.folder / "quick.safetensors")
        again = sherf.Avatar.load(self.folder / "quick.safetensors", people["body"])
        np.testing.assert_array_equal(again.render(size=64).color, frame.color)
        self.assertIn("baked", sherf.info(self.folder / "quick.safetensors"))
        with self.assertRaises(sherf.Unsupported):
            baked.export(self.folder / "x.glb")

    def walk(self):
        poses = np.zeros((3, 72))
        poses[:, 48] = (0, 0.2, 0.4)
        np.savez(self.folder / "walk.npz", poses=poses, trans=np.zeros((3, 3)), betas=np.zeros(10),
                 mocap_framerate=10.0)
        return self.folder / "walk.npz"


class TestHostile(Folder):
    def test_arrays(self):
        body, estimate = people["body"], people["estimate"]
        bad = [("no array", ValueError), (np.zeros((4, 4)), ValueError), (np.zeros((4, 4, 4)), ValueError),
               (np.zeros((0, 4, 3)), ValueError), (np.full((4, 4, 3), np.nan), ValueError),
               (np.full((4, 4, 3), 255.0), ValueError), (np.full((4, 4, 3), -1.0), ValueError),
               (np.zeros((4, 4, 3), np.int64), TypeError), (np.zeros((4, 4, 3), complex), TypeError),
               (np.zeros((4, 4, 3), object), TypeError), ([[1, 2], [3]], ValueError), (None, TypeError)]
        for image, error in bad:
            with self.subTest(image=repr(image)[:40]), self.assertRaises((error, sherf.NoFile)):
                people["estimator"].estimate(image, body)
            with self.subTest(image=repr(image)[:40]), self.assertRaises((TypeError, ValueError)):
                sherf.Observation.create(image, np.ones((4, 4)), estimate.camera, estimate.pose)
        with self.assertRaises(sherf.BadArgument):  # a mask of another size
            sherf.Observation.create(estimate.image, np.ones((4, 4)), estimate.camera, estimate.pose)

    def test_poses_and_cameras(self):
        for poses in (np.zeros(71), np.zeros((3, 24)), np.full((24, 3), np.inf), np.full((24, 3), 1e300), "x", None):
            with self.subTest(poses=repr(poses)[:40]), self.assertRaises((TypeError, ValueError)):
                sherf.Pose(poses)
        pose = people["avatar"].pose
        pose.poses[3, 1] = np.nan
        with self.assertRaisesRegex(ValueError, "finite"):
            people["avatar"].render(pose, size=SIZE)
        pose.poses = None
        with self.assertRaises(TypeError):
            people["avatar"].render(pose, size=SIZE)
        for wrong in (people["body"], "pose", 3):
            with self.assertRaises(TypeError):
                people["avatar"].render(wrong, size=SIZE)
        camera = sherf.Camera(np.zeros((3, 3)), width=SIZE, height=SIZE)
        with self.assertRaises(sherf.Error):
            people["avatar"].render(camera=camera)
        for size in (0, -1, 10**9, 1.5, (1, 2, 3), "x", None):
            with self.subTest(size=size), self.assertRaises((TypeError, ValueError)):
                people["avatar"].render(size=size)

    def test_non_contiguous_pose(self):
        whole = np.zeros((24, 6))
        whole[:, ::2] = 0.1
        np.testing.assert_array_equal(sherf.Pose(whole[:, ::2]).poses, np.full((24, 3), np.float32(0.1)))

    def test_files(self):
        with self.assertRaises(sherf.NoFile) as caught:
            sherf.Body.load("/nowhere/body.npz")
        self.assertIn("/nowhere/body.npz", str(caught.exception))
        self.assertIsInstance(caught.exception, OSError)
        (self.folder / "bad.safetensors").write_bytes(b"\xff" * 100)
        for load in (sherf.Body.load, sherf.Model.load, sherf.Estimator.load, sherf.Avatar.load, sherf.Motion.load,
                     sherf.Pose.load, sherf.Camera.load, sherf.read_image):
            with self.subTest(load=load), self.assertRaises(sherf.Error):
                load(self.folder / "bad.safetensors")
            for path in ("", "a\0b", 3, np.zeros(2)):
                with self.subTest(path=path), self.assertRaises((TypeError, ValueError)):
                    load(path)

    def test_closed(self):
        with sherf.Body.load() as body:
            self.assertFalse(body.closed)
        body.close()
        for use in (lambda: body.faces, lambda: body.pose(sherf.Pose()), lambda: body.__enter__(),
                    lambda: people["estimator"].estimate(PHOTO, body)):
            with self.assertRaisesRegex(sherf.Closed, "Body is closed"):
                use()
        context = sherf.Context(threads=1)
        context.close()
        with self.assertRaises(sherf.Closed):
            sherf.Body.load(context=context)

    def test_wrong_objects(self):
        with self.assertRaises(TypeError):
            sherf.Avatar.from_observation(people["body"])
        with self.assertRaises(TypeError):
            sherf.Body()
        with self.assertRaises(TypeError):
            pickle.dumps(people["body"])
        with self.assertRaises(ValueError):
            sherf.Context(device="abacus")
        with self.assertRaises(sherf.Error):
            sherf.Model.create("gigantic")


class TestContext(unittest.TestCase):
    def test_closed_while_used(self):
        avatar = sherf.Avatar.from_observation(people["estimate"].observation(), body=people["body"],
                                               model=people["model"])
        failed = []

        def draw():
            try:
                while True:
                    avatar.render(size=32)
            except sherf.Closed:
                pass
            except BaseException as error:
                failed.append(error)

        threads = [threading.Thread(target=draw) for _ in range(2)]
        for thread in threads:
            thread.start()
        avatar.close()
        for thread in threads:
            thread.join()
        self.assertEqual(failed, [])

    def test_progress_stops(self):
        def progress(text, done, total):
            raise KeyError(text)

        context = sherf.Context(threads=1, progress=progress)
        with self.assertRaises(KeyError):
            people["estimator"].estimate(PHOTO, people["body"], context=context)
        self.assertEqual(context.device, "cpu")

    def test_progress_cannot_come_back(self):
        context = sherf.Context(threads=1, progress=lambda *_: sherf.Body.load(context=context))
        with self.assertRaisesRegex(sherf.Error, "progress"):
            people["estimator"].estimate(PHOTO, people["body"], context=context)

    def test_garbage(self):
        for _ in range(20):
            sherf.Context(threads=1)
            sherf.Body.load()
        gc.collect()


if __name__ == "__main__":
    logging.basicConfig()
    unittest.main()
