"""Find a Chromium to test with, or install one: `python tests/browser/get_browser.py`."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find():
    """Path of a Chromium, or None: `CHROMIUM`, then the PATH, then playwright's own."""
    named = os.environ.get("CHROMIUM")
    if named:
        if not shutil.which(named):
            raise FileNotFoundError(f"CHROMIUM={named!r} is not a program; name a Chromium.")
        return named
    for name in NAMES:
        if shutil.which(name):
            return shutil.which(name)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as p:
        path = p.chromium.executable_path
    return path if Path(path).exists() else None


def install():
    """Try playwright's browser, then the system's package; the commands tell what they do."""
    is_root = os.geteuid() == 0
    root = [] if is_root else ["sudo", "-n"]  # never asks for a password
    deps = ["--with-deps"] if is_root else []
    ways = [[[sys.executable, "-m", "playwright", "install", *deps, "chromium"]]]
    if shutil.which("apt-get"):
        quiet = [*root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]
        ways.append([[*quiet, "update"], [*quiet, "install", "-y", "chromium"]])
    for way in ways:
        for command in way:
            print("browser tests need a Chromium: running", " ".join(command), flush=True)
            try:
                quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
                subprocess.run(command, check=True, timeout=600, **quiet)
            except (OSError, subprocess.SubprocessError) as error:
                print(f"  did not work: {error}", flush=True)
                break
        if find():
            return find()
    return None


if __name__ == "__main__":
    browser = find() or install()
    if browser is None:
        sys.exit(
            "No Chromium found, and none could be installed. Install one (Debian, Ubuntu: "
            "apt-get install chromium) or name one in the environment variable CHROMIUM."
        )
    print("browser tests use", browser)
