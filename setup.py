"""One package for `pip install .` with the ROS wheels and for `colcon build` in a ROS workspace.

The one place for the metadata; the version is that of `sfr_loc_map/__init__.py`, the requirements of ROS stand in
package.xml.
"""

import re
import subprocess
from functools import partial
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

PACKAGE = "sfr_loc_map"
ROOT = Path(__file__).resolve().parent  # `colcon build --symlink-install` runs a link to this file in another folder
VERSION = re.search(r'__version__ = "(.+)"', (ROOT / PACKAGE / "__init__.py").read_text(encoding="utf-8")).group(1)
PROFILES = glob(PACKAGE + "/ros/profiles/*.xml")  # in share/ for other programs: camera drivers need it
NODES = ("localisation_node", "mapping_node", "monitor_node")
# BSD-2 (Sphinx, copybutton), MIT (MyST, furo, sphinx-design); matplotlib draws the figures of the pages (PSF-like)
DOCS = [
    "furo>=2024.8,<2027",
    "matplotlib>=3.8,<4",
    "myst-parser>=4,<6",
    "sphinx>=8,<10",
    "sphinx-copybutton>=0.5,<0.6",
    "sphinx-design>=0.6,<0.9",
]
TEST = ["coverage>=7.4,<8", "hypothesis>=6.100,<7", "pytest>=8,<10", "pytest-timeout>=2.3,<3", "pytest-xdist>=3.7,<4"]
LIVE = ["aiohttp>=3.14,<4"]
PLOT = ["matplotlib>=3.8,<4"]
NOTEBOOK = [*PLOT, "pandas>=2.2,<4"]
DEM = ["rasterio>=1.3,<2"]
SUITE = ["distributed>=2025.1,<2027", "pyarrow>=17,<27", "fsspec[http]>=2025.2,<2027"]
SEARCH = [*SUITE, "optuna>=4,<6"]
S3 = ["flask>=3,<4", "flask-cors>=5,<7", "moto>=5,<6", "s3fs>=2025.2,<2027"]
MLFLOW = ["mlflow-skinny>=2.20,<4"]


class BuildWithCommit(build_py):
    """Puts commit, branch and date of what is built into the package, for reports; nothing where there is none."""

    def run(self) -> None:
        """Build, then write `commit.txt`."""
        super().run()
        describe = "describe --always --dirty --abbrev=40 --exclude=*"
        asked = (describe, "rev-parse --abbrev-ref HEAD", "show --no-patch --format=%cI")
        run_git = partial(subprocess.run, cwd=ROOT, capture_output=True, text=True, check=True)
        try:
            said = "".join(run_git(["git", *arguments.split()]).stdout for arguments in asked)
        except (OSError, subprocess.CalledProcessError):
            return
        place = Path(self.build_lib) / PACKAGE / "commit.txt"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(said, encoding="utf-8")


setup(
    name=PACKAGE,
    cmdclass={"build_py": BuildWithCommit},
    version=VERSION,
    description="ROS 2 nodes for stereo visual odometry and terrain mapping, with the metrics that evaluate them.",
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="sfr_loc_map maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-77cd1a5b.example",
    keywords=["ros2", "visual odometry", "stereo", "mapping", "point cloud", "evaluation", "benchmark", "rover"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering :: Image Processing",
        "Typing :: Typed",
    ],
    python_requires=">=3.11,<3.14",
    packages=find_packages(include=[PACKAGE, PACKAGE + ".*"]),
    package_data={
        PACKAGE: [
            "py.typed",
            "report/templates/*",
            "live/web/*",
            "ros/profiles/*.xml",
            "mapping/disparity/validity/*.json",
        ],
        "": ["*.pyi"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
        ("share/" + PACKAGE + "/include", glob("include/*.h")),
        ("share/" + PACKAGE + "/examples", glob("examples/*.py") + glob("examples/*.ipynb")),
        ("share/" + PACKAGE + "/examples/c_candidate", glob("examples/c_candidate/*")),
        ("share/" + PACKAGE + "/launch_scripts", glob("launch_scripts/*.launch.py")),
        ("share/" + PACKAGE + "/config", [*glob("config/*.yaml"), *glob("config/*.xml"), *PROFILES]),
        ("share/" + PACKAGE + "/config/examples", glob("config/examples/*")),
        ("share/" + PACKAGE + "/config/simulation", glob("config/simulation/*.yaml")),
        ("share/" + PACKAGE + "/config/suites", glob("config/suites/*.yaml")),
        ("lib/" + PACKAGE, [f"scripts/{name}" for name in NODES]),  # for `ros2 run` after pip install
    ],
    install_requires=[
        "setuptools",
        "jinja2>=3.1,<4",  # BSD-3
        "lazy-loader>=0.4,<1",  # BSD-3; a public name costs nothing until it is used
        "msgspec>=0.19,<0.23",  # BSD-3; records to and from JSON
        "numba>=0.64,<0.70",  # BSD-2
        "numpy>=1.26,<3",  # BSD-3
        "opencv-python-headless>=4.10,<5",  # Apache-2.0
        "plotly>=5.18,<8",  # MIT
        "psutil>=5.9,<8",  # BSD-3
        "pyyaml>=6,<7",  # MIT
        "rich>=13,<16",  # MIT
        "rosbags>=0.11.9,<0.12",  # Apache-2.0; mcap files are read by io/bag/mcap_file.py
        "scipy>=1.11,<2",  # BSD-3
        "simplejpeg>=1.7,<2",  # MIT; refuses broken JPEG data that OpenCV decodes without a word
        "typer>=0.19,<1",  # MIT
    ],
    extras_require={
        "sim": ["embreex>=4.4,<5"],  # MIT; bundles Embree, Apache-2.0
        # ROS 2 Jazzy as wheels, for machines without a ROS install
        "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1,<7.2", "ros-jazzy-common-interfaces>=5.3,<5.4"],
        # BSD-3 and Apache-2.0; runs of suites, here or on a cluster, sources elsewhere, results as a table for pandas
        "suite": SUITE,
        "search": SEARCH,  # MIT; sfr suite search
        "live": LIVE,  # Apache-2.0; the page of sfr live
        "docs": DOCS,  # the documentation site
        "dem": DEM,  # BSD-3; bundles GDAL, MIT; elevation models as GeoTIFF
        "plot": PLOT,  # PSF-like; PNG of sfr plot
        "notebook": NOTEBOOK,  # PSF-like, BSD-3; to_pandas of trajectories and scores, and figures of their tables
        "mlflow": MLFLOW,  # Apache-2.0; sfr suite report --mlflow
        "test": TEST,
        # cyclonedds: EPL-2.0 or BSD-3; a DDS client that is not ROS, for tests
        "dev": [
            *TEST,
            *SEARCH,
            *LIVE,
            *DEM,
            *NOTEBOOK,
            *MLFLOW,
            *S3,  # BSD-3, MIT, Apache-2.0, BSD-3; a server of object storage, and what reads it, for tests
            "colcon-common-extensions>=0.3,<1",  # Apache-2.0; builds the package as a ROS workspace does, for tests
            "cyclonedds>=11,<12",
            "ipython>=8,<10",  # BSD-3; runs the cells of the notebook, for a test
            "mypy>=1.13,<3",
            "pre-commit>=4,<6",  # MIT
            "ruff>=0.8,<0.18",
            "scipy-stubs",
            "types-PyYAML",
            "types-psutil",
        ],
    },
    entry_points={
        "console_scripts": [
            "sfr = sfr_loc_map.cli.main:main",
            *(f"{name} = sfr_loc_map.nodes.start:{name}" for name in NODES),
        ]
    },
    zip_safe=False,
)
