"""Builds the wheel. Its version is the library's; its tag is any Python 3 on this machine's platform, whose library it
contains."""

import re
from pathlib import Path

from setuptools import setup
from wheel.bdist_wheel import bdist_wheel

source = (Path(__file__).parent / "sherf/_library.py").read_text(encoding="utf-8")


class WithLibrary(bdist_wheel):
    """A wheel that contains a shared library: for one platform, but for any Python 3."""

    def finalize_options(self):
        """Marks the wheel as one for a platform."""
        super().finalize_options()
        self.root_is_pure = False

    def get_tag(self):
        """The wheel's tag: any Python 3, no ABI of Python, this platform."""
        return ("py3", "none", super().get_tag()[2])


setup(version=re.search(r'^VERSION = "(.*?)"', source, re.M).group(1), cmdclass={"bdist_wheel": WithLibrary})
