"""Finds the program sherf, builds its command lines, reads its output and runs it in the background.
Needs no Blender."""
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time

PHOTOS = (".jpg", ".jpeg", ".png", ".webp", ".heic", ".heif", ".avif")
VIDEOS = (".mp4", ".mov", ".webm", ".mkv", ".avi", ".m4v")
DETAIL = {"LOW": (128, 12000), "MEDIUM": (256, 50000), "HIGH": (384, 150000)}  # cells, triangles
HERE = os.path.dirname(os.path.abspath(__file__))


class Failure(Exception):
    """An error, as one line for the user."""


# ---- where it is ----
def usual_places(folder=HERE):
    """Where the program may be if it is not on PATH: beside the add-on, and where `make install` puts it."""
    name = "sherf.exe" if os.name == "nt" else "sherf"
    places = [os.path.join(folder, name), os.path.join(folder, "bin", name)]
    if os.name != "nt":
        places += ["/usr/local/bin/sherf", os.path.expanduser("~/.local/bin/sherf"), "/opt/sherf/bin/sherf"]
    return places


def is_program(path):
    """Whether `path` is a file that can be run."""
    return os.path.isfile(path) and os.access(path, os.X_OK)


def find_program(chosen="", folder=HERE):
    """The path of the program: chosen in the preferences, on PATH, beside the add-on or installed. Raises Failure."""
    if chosen:
        path = os.path.abspath(os.path.expanduser(chosen))
        if is_program(path):
            return path
        raise Failure(f"{path}: no such program; correct the path in the preferences of the add-on sherf")
    found = shutil.which("sherf")
    if found:
        return os.path.abspath(found)
    for path in usual_places(folder):
        if is_program(path):
            return path
    raise Failure("the program sherf was not found, neither on PATH nor beside the add-on "
                  f"({folder}); build it (make program) and name it in the preferences of the add-on sherf")


# ---- command lines ----
def kind_of(path):
    """The kind of a file to import: "glb", "avatar" or "photo" (observations count as photos). Raises Failure."""
    if not os.path.exists(path):
        raise Failure(f"{path}: no such file")
    end = os.path.splitext(path)[1].lower()
    if os.path.isdir(path) or end in PHOTOS + (".json",):
        return "photo"
    if end in (".glb", ".safetensors"):
        return "glb" if end == ".glb" else "avatar"
    raise Failure(f"{path}: neither an avatar (.safetensors), a .glb of sherf export, nor a photo "
                  f"({', '.join(PHOTOS)})")


def photos_of(path, chosen):
    """The files to import, `path` first. chosen: the names of all selected files in the same folder, as the file
    browser gives them. Several files must be photos of one person; otherwise Failure is raised."""
    folder, shown = os.path.split(path)
    names = sorted((name for name in chosen if name), key=lambda name: name != shown)
    if len(names) < 2:
        return [path]
    paths = [os.path.join(folder, name) for name in names]
    for other in paths:
        if kind_of(other) != "photo":
            raise Failure(f"{other}: no photo; several files at once are photos of one person, "
                          "anything else comes alone")
    return paths


def body_words(body, beside):
    """The --body argument: the body of the preferences, or one beside the file, where the program would find it."""
    if body:
        return ["--body", os.path.abspath(body)]
    folder = os.path.abspath(beside if os.path.isdir(beside) else os.path.dirname(os.path.abspath(beside)))
    for name in ("body.safetensors", "tubeman.safetensors"):
        path = os.path.join(folder, name)
        if os.path.isfile(path):
            return ["--body", path]
    return []


def avatar_command(program, photos, avatar, person=0, body=""):
    """The command that makes an avatar from one person's photos."""
    words = [program, "avatar"] + [os.path.abspath(photo) for photo in photos] + ["--output", os.path.abspath(avatar)]
    if person:
        words += ["--person", str(person)]
    return words + body_words(body, photos[0])


def export_command(program, avatar, glb, detail="MEDIUM", texture_px=1024, observed=False, body=()):
    """The command that exports an avatar as .glb, in the T-pose or the observed pose."""
    cells, triangles = DETAIL[detail]
    words = [program, "export", os.path.abspath(avatar), "--output", os.path.abspath(glb), "--lit", "--resolution",
             str(cells), "--triangles", str(triangles), "--texture", str(texture_px)]
    return words + (["--pose", "observation"] if observed else []) + list(body)


def video_command(program, video, npz, person=0):
    """The command that estimates the motion of a person in a video."""
    words = [program, "estimate", os.path.abspath(video), "--output", os.path.abspath(npz)]
    return words + (["--person", str(person)] if person else [])


def motion_command(program, avatar, motion, bvh, fps, body=(), root="kept", up="auto", track="", first=0, last=0,
                   smooth_s=0.0, loop=False):
    """The command that writes a motion as BVH in the file's own world; avatar "" means the mean body."""
    words = [program, "animate"] + ([os.path.abspath(avatar)] if avatar else [])
    words += ["--motion", os.path.abspath(motion), "--bvh", os.path.abspath(bvh), "--own-place", "--blend", "0"]
    words += ["--fps", f"{fps:.9g}", "--root", root, "--up", up]
    if track:
        words += ["--track=" + track]
    if first:
        words += ["--first", str(first)]
    if last:
        words += ["--last", str(last)]
    if smooth_s > 0:
        words += ["--smooth", f"{smooth_s:.6g}"]
    return words + (["--loop"] if loop else []) + list(body)


def free_name(folder, stem, ending):
    """FOLDER/STEM.ending, or STEM-2.ending and so on if that exists already."""
    path, n = os.path.join(folder, stem + ending), 2
    while os.path.lexists(path):
        path, n = os.path.join(folder, f"{stem}-{n}{ending}"), n + 1
    return path


# ---- what it says ----
def failure_line(log, code):
    """The program's error message, without its name and the hint at --help."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    for line in reversed(lines):
        match = re.match(r"sherf( [a-z]+)?: (?!warning: )(.*)", line)
        if match:
            return re.sub(r" \(see 'sherf[^']*'\)$", "", match.group(2))
    if code < 0:
        return f"the program sherf was ended by signal {-code}"
    return f"the program sherf failed (status {code}){': ' + lines[-1] if lines else ''}"


def remarks(log, photos=()):
    """(warnings, lines about what was found in the photos), as two lists."""
    warning = "sherf: warning: "
    lines = log.splitlines()
    return ([line[len(warning):] for line in lines if line.startswith(warning)],
            [line for line in lines if any(line.startswith(os.path.abspath(photo) + ": ") for photo in photos)])


def percent(log):
    """The last progress figure as (what, percent), or None."""
    found = re.findall(r"^([^:\n]+): +(\d+)%", log, re.MULTILINE)
    return (found[-1][0], int(found[-1][1])) if found else None


def version(program):
    """The output of `sherf --version`. Raises Failure if `program` is not sherf."""
    try:
        done = subprocess.run([program, "--version"], stdin=subprocess.DEVNULL, capture_output=True, timeout=20,
                              check=False)
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise Failure(f"{program}: cannot be run: {error}") from error
    said = done.stdout.decode("utf-8", "replace").strip()
    if done.returncode or not said.startswith("sherf "):
        raise Failure(f"{program}: is not the program sherf")
    return said.splitlines()[0]


# ---- running it ----
class Job:
    """Runs commands one after another in a temporary folder, which close() removes.

    steps: a list of (description, command line), set before the first poll. Only cancel() waits, and for two seconds
    at most."""

    def __init__(self):
        self.folder = tempfile.mkdtemp(prefix="sherf-")
        self.steps, self.at, self.process, self.log_file = [], -1, None, None
        self.begun_s, self.logs, self.cancelled = time.monotonic(), [], False

    def file(self, name):
        """The path of a file in the job's folder."""
        return os.path.join(self.folder, name)

    def log(self):
        """The output so far of the running command, or that of the last one."""
        try:
            with open(self.file("log"), encoding="utf-8", errors="surrogateescape") as f:
                return f.read()
        except OSError:
            return ""

    def _start(self):
        """Runs the next command. Raises Failure if it cannot be run."""
        self.at += 1
        hidden = {"creationflags": subprocess.CREATE_NO_WINDOW} if os.name == "nt" else {}
        try:
            with open(self.file("log"), "wb") as log:
                self.process = subprocess.Popen(self.steps[self.at][1], stdin=subprocess.DEVNULL,
                                                stdout=subprocess.DEVNULL, stderr=log, cwd=self.folder, **hidden)
        except (OSError, ValueError) as error:
            raise Failure(f"{self.steps[self.at][1][0]}: cannot be run: {error}") from error

    def poll(self):
        """Starts the next command if none runs. Returns True when all are done; raises Failure if one failed."""
        if self.process is None:
            if self.at + 1 >= len(self.steps):
                return True
            self._start()
        code = self.process.poll()
        if code is None:
            return False
        self.process = None
        log = self.log()
        self.logs.append(log)
        if code:
            raise Failure(failure_line(log, code))
        return self.at + 1 >= len(self.steps)

    def state(self):
        """A status line for the user, and the progress of this command in percent (None: unknown)."""
        text = self.steps[max(self.at, 0)][0] if self.steps else "sherf"
        done = percent(self.log())
        figure = f", {done[0]} {done[1]} %" if done else ""
        return (f"sherf: {text}{figure}, {time.monotonic() - self.begun_s:.0f} s",
                done[1] if done else None)

    def cancel(self):
        """Stops the running command with SIGTERM, so that it can clean up, and kills it after two seconds."""
        self.cancelled = True
        process, self.process = self.process, None
        if process is None or process.poll() is not None:
            return
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(2)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def close(self):
        """Stops the running command and removes the folder."""
        self.cancel()
        shutil.rmtree(self.folder, ignore_errors=True)
