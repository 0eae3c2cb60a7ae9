"""The type control_msgs/FollowJointTrajectory for tests where it is not installed: generated and compiled.

Real type support, by the generators that come with rclpy's wheels, of the fields that the controller reads and fills.
"""

import shutil
import subprocess
import sys
import sysconfig
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

PACKAGE = "control_msgs"
TEXTS = {
    "msg/JointTolerance.msg": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "action/FollowJointTrajectory.action": """\
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointTolerance[] goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
""",
}
USED = (
    *("trajectory_msgs", "geometry_msgs", "std_msgs", "builtin_interfaces"),  # by the texts
    *("action_msgs", "service_msgs", "unique_identifier_msgs"),  # by each action
)
SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
"""What Fast DDS needs: how messages are written as bytes, and of what they consist."""
RUNTIME = ("rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_cpp", "rcutils", "rmw", "fastcdr")
ROOT = Path(sys.prefix)


def _generate(folder: Path) -> None:
    """Write the sources, those of each generator into a folder of its name."""
    for name, text in TEXTS.items():
        path = folder / "texts" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    translate = import_module("rosidl_cli.command.translate.api").translate
    common = {"package_name": PACKAGE, "include_paths": [str(ROOT / "share")]}
    files = translate(
        interface_files=[f"{folder}/texts:{name}" for name in TEXTS],
        output_format="idl",
        output_path=folder / "share" / PACKAGE,
        **common,
    )
    for module, generator, options in (
        ("rosidl_generator_c", "GenerateC", {}),
        ("rosidl_generator_py", "GeneratePython", {"typesupport_implementations": ["rosidl_typesupport_c"]}),
        ("rosidl_typesupport_c", "GenerateCTypesupport", {"typesupport_implementations": list(SUPPORTS)}),
        (SUPPORTS[0], "GenerateFastRTPSCTypesupport", {}),
        (SUPPORTS[1], "GenerateIntrospectionCTypesupport", {}),
    ):
        made = getattr(import_module(f"{module}.cli"), generator)(module, **options)
        out = folder / module / PACKAGE
        out.mkdir(parents=True)
        made.generate(interface_files=files, output_path=out, **common)


def _compile(folder: Path) -> None:
    """Compile a library from each folder, with the names by which ROS looks for them."""
    package, libraries = folder / "rosidl_generator_py" / PACKAGE, ROOT / "lib"
    includes = [folder / module for module in ("rosidl_generator_c", *SUPPORTS)]
    includes += [ROOT / "include", *(ROOT / "include").iterdir(), Path(sysconfig.get_path("include"))]
    includes += [Path(np.get_include())]
    used = [path.stem for name in USED for path in libraries.glob(f"lib{name}__rosidl_*.so")]
    links = [f"-l{name.removeprefix('lib')}" for name in used if name.endswith(("_c", "_py"))]
    links += [f"-l{name}" for name in (*RUNTIME, SUPPORTS[0])]
    own: list[str] = []
    for name, modules in (
        (f"lib{PACKAGE}__rosidl_generator_c", ["rosidl_generator_c"]),
        *((f"lib{PACKAGE}__{support}", [support]) for support in SUPPORTS),
        (f"{PACKAGE}_s__rosidl_typesupport_c", ["rosidl_generator_py", "rosidl_typesupport_c"]),
    ):
        sources = [path for module in modules for path in (folder / module).rglob("*.c*")]
        command = [
            "gcc",
            "-shared",
            "-fPIC",
            "-O0",
            "-w",
            *sources,
            "-Wl,--no-as-needed",
            *own,
            *(f"-I{path}" for path in includes),
        ]
        command += [f"-L{libraries}", *links, "-lstdc++", f"-Wl,-rpath,{libraries}:$ORIGIN", f"-Wl,-soname,{name}.so"]
        subprocess.run([*command, "-o", package / f"{name}.so"], check=True)
        own.append(str(package / f"{name}.so"))
    (package / "__init__.py").touch()


def importable(folder: Path) -> Path:
    """Build the package in a folder and return the path from which it can be imported; skip what cannot build it."""
    for module in ("rosidl_cli", "rosidl_generator_py", *SUPPORTS):
        pytest.importorskip(module, reason="needs control_msgs, or the generators of ROS 2 to build its action")
    needed = shutil.which("gcc"), Path(sysconfig.get_path("include")) / "Python.h", ROOT / "share" / SUPPORTS[0]
    if not all(each and Path(each).exists() for each in needed):
        pytest.skip("needs control_msgs, or a compiler, Python.h and ROS 2 as wheels to build its action")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AMENT_PREFIX_PATH", str(ROOT))
        _generate(folder)
    _compile(folder)
    return folder / "rosidl_generator_py"
