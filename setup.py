"""Package for ament_python (colcon) and for pip."""

from glob import glob
from importlib.util import find_spec
from pathlib import Path

from setuptools import find_packages, setup

NAME = "backlash_ros"

# Where ROS is installed, rclpy and the messages come from there. Where it is not, from wheels.
ROS_WHEELS = [
    "ros-rclpy[fastrtps]>=7.1.6,<8",
    "ros-diagnostic-msgs>=5.3.6,<6",
    "ros-lifecycle-msgs>=2.0.3,<3",
    "ros-rcl-interfaces>=2.0.3,<3",
    "ros-rosgraph-msgs>=2.0.3,<3",
    "ros-sensor-msgs>=5.3.6,<6",
    "ros-std-msgs>=5.3.6,<6",
    "ros-std-srvs>=5.3.6,<6",
    "ros-trajectory-msgs>=5.3.6,<6",
]

setup(
    name=NAME,
    version="0.1.0",
    description="Servo control of geared drives with backlash, on ROS 2",
    long_description=Path("README.md").read_text(),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    author="backlash_ros maintainers",
    maintainer="backlash_ros maintainers",
    maintainer_email="maintainers@backlash-ros.example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        f"{NAME}.ros": ["*.xml"],
        f"{NAME}.commands": ["*.csv"],
        f"{NAME}.pages": ["*.j2", "*/*.j2", "*/*.js", "*/*.css", "report/echarts/*"],
        f"{NAME}.dashboard": ["static/*"],
        f"{NAME}.export.c": ["*.j2"],
    },
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Manufacturing",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 15)),
        "Topic :: Scientific/Engineering",
        "Topic :: System :: Hardware",
    ],
    python_requires=">=3.10",
    install_requires=[
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "numba>=0.58",
        "numpy>=1.26",
        "pyyaml>=6.0",
        "rich>=13",
        "rosbags>=0.11,<0.12",  # the recorder extends its writer of mcap files
        "scipy>=1.11",
        *(ROS_WHEELS if find_spec("rclpy") is None else []),
    ],
    extras_require={
        "contract": ["pytest>=7.4"],
        "cluster": ["distributed>=2024.2"],  # backlash evaluate --scheduler
        "page": ["nicegui>=3.13,<4"],  # dashboard
        "tables": ["pandas>=2.1", "pyarrow>=15.0"],  # Run.to_frame, backlash evaluate --out
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", [*glob("config/*"), f"{NAME}/ros/loopback_udp.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    entry_points={
        "console_scripts": [
            f"plant_simulator = {NAME}.nodes.plant_simulator:main",
            f"controller = {NAME}.nodes.controller:main",
            f"recorder = {NAME}.nodes.recorder:main",
            f"dashboard = {NAME}.dashboard.command:main",
            f"backlash = {NAME}.cli:main",
        ],
        # Named like the module: with -p besides, pytest takes it once.
        "pytest11": [f"{NAME}.contract.plugin = {NAME}.contract.plugin"],
    },
    zip_safe=False,
)
