"""What all tests share: designs that are kept on disk go to a folder of this run."""

import os
import shutil
import tempfile

_FOLDER = "CAMLESS_CACHE"


def pytest_configure(config):
    if not hasattr(config, "workerinput"):  # workers inherit it
        config.camless_folder = os.environ[_FOLDER] = tempfile.mkdtemp(prefix="camless-tests-")


def pytest_unconfigure(config):
    folder = getattr(config, "camless_folder", None)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
