"""A DDS writer that blocks holds up its own thread only.

The middleware's publish is replaced by one that waits, in C, until a file is gone, which another thread of
the same interpreter removes. If `publish` kept Python's lock, nobody could: rclpy's does, and when that has
changed, the second case fails and `crtk_drivers/ros/unlocked.py` can go.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros

GAVE_UP = 3

BLOCKED_WRITER = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <unistd.h>

typedef int (*Publish)(const void *, const void *, void *);

static int publish(const char *name, const void *publisher, const void *message, void *allocation)
{
  for (int tries = 0; access(getenv("BLOCKED"), F_OK) == 0; tries++) {
    if (tries > 500) _exit(3);
    usleep(10000);
  }
  void *middleware = dlopen("librmw_implementation.so", RTLD_NOLOAD | RTLD_LAZY);
  if (!middleware) middleware = dlopen("librmw_fastrtps_cpp.so", RTLD_NOLOAD | RTLD_LAZY);
  return ((Publish) dlsym(middleware, name))(publisher, message, allocation);
}

int rmw_publish(const void *publisher, const void *message, void *allocation)
{
  return publish("rmw_publish", publisher, message, allocation);
}

int rmw_publish_serialized_message(const void *publisher, const void *message, void *allocation)
{
  return publish("rmw_publish_serialized_message", publisher, message, allocation);
}
"""

PROGRAM = """
import os, pathlib, sys, threading
import rclpy
from crtk_drivers.ros.unlocked import UnlockedNode
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = {"rclpy": Node, "unlocked": UnlockedNode}[sys.argv[1]]("blocked", enable_rosout=False)
publisher = node.create_publisher(String, "text", 10)
begun = threading.Event()

def unblock():
    begun.wait()
    blocked.unlink()

blocked = pathlib.Path(os.environ["BLOCKED"])
thread = threading.Thread(target=unblock)
thread.start()
sys.setswitchinterval(10.0)  # the other thread runs when this one lets it, and not before
blocked.touch()
begun.set()
publisher.publish(String(data="through"))
thread.join()
os._exit(0)
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("writer") / "blocked_writer.so"
    compiler = shutil.which("cc")
    assert compiler, "a C compiler is needed, as for building crtk_msgs"
    command = [compiler, "-shared", "-fPIC", "-x", "c", "-o", str(path), "-", "-ldl"]
    subprocess.run(command, input=BLOCKED_WRITER, text=True, check=True)
    return path


@pytest.mark.parametrize(
    ("kind", "code"),
    [("unlocked", 0), pytest.param("rclpy", GAVE_UP, marks=pytest.mark.slow)],
)
def test_a_blocked_writer_stops_no_other_thread(
    library: Path, tmp_path: Path, kind: str, code: int
) -> None:
    environment = {**os.environ, "LD_PRELOAD": str(library), "BLOCKED": str(tmp_path / "blocked")}
    command = [sys.executable, "-c", PROGRAM, kind]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100)
    assert ended.returncode == code, ended.stderr
