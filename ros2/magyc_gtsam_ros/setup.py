"""For colcon: an ament_python package."""

from glob import glob

from setuptools import setup

NAME = "magyc_gtsam_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools", "magyc-gtsam"],
    zip_safe=True,
    license="MIT",
    entry_points={"console_scripts": [f"online = {NAME}.online_node:main"]},
)
