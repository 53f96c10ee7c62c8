"""The folders at the top are the packages below `koala3d`; all else is in pyproject.toml."""

from setuptools import find_namespace_packages, setup

FOLDERS = ("capture", "calib", "reconstruct", "datasets", "configs")

setup(
    packages=[f"koala3d.{name}" for folder in FOLDERS for name in find_namespace_packages(include=[folder, f"{folder}.*"])],
    package_dir={f"koala3d.{folder}": folder for folder in FOLDERS},
)
