"""Build script for colcon (ament_python) and pip."""

import sys
import sysconfig
from glob import glob

from setuptools import __version__ as setuptools_version
from setuptools import find_packages, setup

NAME = "ins_nav"
# Without this, old pip with setuptools < 80 puts editable commands where setup.cfg says, as colcon (--editable) must.
OLD_PIP = "develop" in sys.argv and "--editable" not in sys.argv and int(setuptools_version.split(".")[0]) < 80

setup(
    name=NAME,
    version="0.1.0",
    description="Inertial navigation for ROS 2: mechanization, alignment and calibration at stops.",
    maintainer="ins_nav maintainers",
    maintainer_email="maintainers@ins-nav.example",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    options={"develop": {"script_dir": sysconfig.get_path("scripts")}} if OLD_PIP else {},
    zip_safe=False,
    python_requires=">=3.11",
    install_requires=[
        "matplotlib>=3.6",
        "numba>=0.58",
        "numpy>=1.26",
        "pyyaml>=6.0",
        "rosbags>=0.11.7",  # the first that brings apsw, lz4 and backports.zstd, which reading damaged bags needs
        "scipy>=1.11",
        "tqdm>=4.60",
    ],
    extras_require={
        # ROS 2 Jazzy for machines without it: CPython 3.11 to 3.13 on x86-64 Linux.
        "jazzy": ["ros-jazzy-common-interfaces>=5.3", "ros-jazzy-rclpy[fastrtps]>=7.1"],
        "test": [
            "colcon-common-extensions>=0.3",
            "hypothesis>=6.80",
            "import-linter>=2.0",
            "mypy>=1.10",
            "pyproj>=3.6",
            "pytest>=8.0",
            "pytest-xdist>=3.5",
            "python-ins>=1.0",
            "ruff>=0.9",
            "types-PyYAML>=6.0",
        ],
    },
    entry_points={
        "console_scripts": [
            "alignment_node = ins_nav.nodes.commands:alignment_node",
            "bag_player = ins_nav.nodes.commands:bag_player",
            "ins_node = ins_nav.nodes.commands:ins_node",
            "ins_process = ins_nav.cli.process:main",
            "ins_report = ins_nav.cli.report:main",
            "ins_simulate = ins_nav.cli.simulate:main",
            "ins_system = ins_nav.nodes.commands:ins_system",
            "stop_detector_node = ins_nav.nodes.commands:stop_detector_node",
        ],
    },
)
