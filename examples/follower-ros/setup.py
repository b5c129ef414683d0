"""For colcon; the follower itself is the Python package drone-target-follower."""

from setuptools import setup

SHARE = "share/follower_ros"

setup(
    name="follower_ros",
    version="0.1.0",
    packages=["follower_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/follower_ros"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", ["launch/follower.launch.py"]),
        (f"{SHARE}/config", ["config/follower.yaml", "config/large_images.xml"]),
    ],
    install_requires=["setuptools"],
    license="Apache-2.0",
    entry_points={"console_scripts": ["follower = follower_ros.node:main"]},
)
