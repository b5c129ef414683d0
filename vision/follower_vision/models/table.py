"""The table of networks. Every file is checked against its sha256, wherever it came from."""

from __future__ import annotations

from follower_vision.models.model import Model, ModelFile, Purpose

_RAW = "https://raw.githubusercontent.com"
_SIAM = f"{_RAW}/HonglinChu/SiamTrackers"
# The commit that OpenCV's own examples take NanoTrack from.
_SIAM_PINNED = f"{_SIAM}/c2ff8479624b12ef2dcd830c47f2495a2c4852d4/NanoTrack/models"
_SIAM_V3 = f"{_SIAM}/4dbbbbc99d4e1f06d4b0a89cadb59d883553b1b4/NanoTrack/models"
_SIAM_NEWEST = f"{_SIAM}/master/NanoTrack/models"
# These are kept in Git LFS, which answers under another address than plain files.
_ZOO = "https://media.githubusercontent.com/media/opencv/opencv_zoo"
_COCO = "COCO's 80"


def _siam(path: str, *bases: str) -> tuple[str, ...]:
    return tuple(f"{base}/{path}" for base in (*bases, _SIAM_NEWEST))


MODELS: tuple[Model, ...] = (
    Model(
        name="follower-detector",
        purpose=Purpose.DETECTOR,
        summary="our own, 256 pixels, for the simulator's scenes alone; comes along",
        licence="Apache-2.0",
        origin="this project: follower train detector",
        family="yolov2",
        classes="person, car, boat, quadrotor",
        embedded=True,
        files=(
            ModelFile(
                "follower-detector.onnx",
                3796726,
                "d956c23bfffc18843b7cae6fb8ad755ea7d3a6c28aa772cbb52224343c6a967d",
            ),
        ),
    ),
    Model(
        name="follower-re3",
        purpose=Purpose.TRACKER,
        summary="our own Re3, from generated scenes alone; comes along",
        licence="Apache-2.0",
        origin="this project: follower train re3",
        embedded=True,
        files=(
            ModelFile(
                "follower-re3.onnx",
                2657773,
                "1669be1ba1b4e5ade6c20d490f7cae30807d190a82aa9341afefda6841caf975",
            ),
        ),
    ),
    Model(
        name="nanotrack-v3",
        purpose=Purpose.TRACKER,
        summary="NanoTrack 3, the most accurate of the three",
        licence="Apache-2.0",
        origin="HonglinChu/SiamTrackers",
        usual=True,
        files=(
            ModelFile(
                "nanotrackv3_backbone.onnx",
                1431635,
                "50be1320abf9384fd3479ea829f95e244cf3f3838190c5ab60c750fb8c1ce828",
                _siam("nanotrackv3/nanotrack_backbone.onnx", _SIAM_V3),
            ),
            ModelFile(
                "nanotrackv3_head.onnx",
                1183740,
                "75357903be3f4817c965af16cb5a11fd32b1467f597a408405a98635ac63f61d",
                _siam("nanotrackv3/nanotrack_head.onnx", _SIAM_V3),
            ),
        ),
    ),
    Model(
        name="nanotrack-v2",
        purpose=Purpose.TRACKER,
        summary="NanoTrack 2, also what OpenCV's TrackerNano takes",
        licence="Apache-2.0",
        origin="HonglinChu/SiamTrackers",
        files=(
            ModelFile(
                "nanotrackv2_backbone.onnx",
                1056849,
                "530bdd0cd00f19afab79a863e71ba71e3312395a5dc9151af675082bdaaa2fc4",
                _siam("nanotrackv2/nanotrack_backbone_sim.onnx", _SIAM_PINNED),
            ),
            ModelFile(
                "nanotrackv2_head.onnx",
                726198,
                "0d8c0637be849f092cc7236cae02e55c8b9455ebe37ba50601d6115db4247cd9",
                _siam("nanotrackv2/nanotrack_head_sim.onnx", _SIAM_PINNED),
            ),
        ),
    ),
    Model(
        name="nanotrack-v1",
        purpose=Purpose.TRACKER,
        summary="NanoTrack 1, the smallest",
        licence="Apache-2.0",
        origin="HonglinChu/SiamTrackers",
        files=(
            ModelFile(
                "nanotrackv1_backbone.onnx",
                767819,
                "f6fdf311bdc846510c2f9f0b2b8159c7e0cf5d80ed18c9079faeb32db460cba9",
                _siam("nanotrackv1/nanotrack_backbone_sim.onnx", _SIAM_PINNED),
            ),
            ModelFile(
                "nanotrackv1_head.onnx",
                392202,
                "4c987e5121cc400b6175f2168c30c84857864fe36d5e7a14df0c27e8e5b9540d",
                _siam("nanotrackv1/nanotrack_head_sim.onnx", _SIAM_PINNED),
            ),
        ),
    ),
    Model(
        name="yolox-nano",
        purpose=Purpose.DETECTOR,
        summary="YOLOX nano, 416 pixels: the best of the light ones",
        licence="Apache-2.0 upstream",
        origin="Megvii-BaseDetection/YOLOX; from Bigisland1729/object-detection-models, "
        "which states no licence of its own",
        family="yolox",
        classes=_COCO,
        usual=True,
        files=(
            ModelFile(
                "yolox_nano_bi.onnx",
                3678356,
                "e8af074932d4ed7e232278e3055cefcdea3edf178874a3694ae292649fb464dd",
                (
                    f"{_RAW}/Bigisland1729/object-detection-models/"
                    "6e770c5ef34fa42aaa2521eb7d0d9ec2bb5f40a3/yolox_nano.onnx",
                ),
            ),
        ),
    ),
    Model(
        name="fastestdet",
        purpose=Purpose.DETECTOR,
        summary="FastestDet, 352 pixels: a third of YOLOX nano's time, many false boxes",
        licence="BSD-3-Clause",
        origin="dog-qiuqiu/FastestDet",
        family="fastestdet",
        classes=_COCO,
        files=(
            ModelFile(
                "fastestdet.onnx",
                998169,
                "31cb14c017fce347cb4c846ec62fdf00d76bb3beecdf4be21e7116ac67feb880",
                (
                    f"{_RAW}/dog-qiuqiu/FastestDet/main/example/onnx-runtime/FastestDet.onnx",
                    f"{_RAW}/dog-qiuqiu/FastestDet/97df0a850c4949dcd7d9abf9c539679eee6b6a90/"
                    "example/onnx-runtime/FastestDet.onnx",
                ),
            ),
        ),
    ),
    Model(
        name="nanodet-m",
        purpose=Purpose.DETECTOR,
        summary="NanoDet-m, 416 pixels",
        licence="Apache-2.0 upstream",
        origin="RangiLyu/nanodet; from hpc203/nanodet-opncv-dnn-cpp-python, "
        "which states no licence of its own",
        family="nanodet",
        classes=_COCO,
        files=(
            ModelFile(
                "nanodet_m.onnx",
                3800954,
                "4b82da9944b88577175ee23a459dce2e26e6e4be573def65b1055dc2d9720186",
                (
                    f"{_RAW}/hpc203/nanodet-opncv-dnn-cpp-python/"
                    "f46e225a0c92ef611395425940927cc4cbef3fb5/nanodet_m.onnx",
                ),
            ),
        ),
    ),
    Model(
        name="osnet-x0.25",
        purpose=Purpose.APPEARANCE,
        summary="OSNet x0.25 (MSMT17): tells one person from another; bring your own export",
        licence="MIT upstream",
        origin="KaiyangZhou/deep-person-reid",
        files=(
            ModelFile(
                "osnet_x0_25_msmt17_b.onnx",
                891413,
                "dddd73c80b78e24ef982f9c352c1947b42d67433887011e8eb33a00313edef5e",
            ),
        ),
    ),
    Model(
        name="vit",
        purpose=Purpose.TRACKER,
        summary="VitTrack, for OpenCV's TrackerVit; not tried by us",
        licence="Apache-2.0",
        origin="opencv/opencv_zoo",
        files=(
            ModelFile(
                "vittrack.onnx",
                714726,
                "2990f0b7cd44d92afa48cd97db6de7be113fc1d9594fddb74e2725c10478e91d",
                (
                    f"{_ZOO}/fef72f8fa7c52eaf116d3df358d24e6e959ada0e/models/"
                    "object_tracking_vittrack/object_tracking_vittrack_2023sep.onnx",
                ),
            ),
        ),
    ),
    Model(
        name="dasiamrpn",
        purpose=Purpose.TRACKER,
        summary="DaSiamRPN, for OpenCV's TrackerDaSiamRPN; not tried by us",
        licence="Apache-2.0",
        origin="opencv/opencv_zoo",
        files=(
            ModelFile(
                "dasiamrpn_model.onnx",
                91040894,
                "e88370b85cbad914a5eb414d9d9e0820f87fd0cd89b65205a766174206c35719",
                (
                    f"{_ZOO}/89696dacd6bd819dfd67dbb0935d778e0dc5cdc4/models/"
                    "object_tracking_dasiamrpn/object_tracking_dasiamrpn_model_2021nov.onnx",
                ),
            ),
            ModelFile(
                "dasiamrpn_kernel_r1.onnx",
                47206788,
                "082c85d231b88b97a1b2a50e73b640a332c5d98d7c1d80b5da9ab534fa7a9e5b",
                (
                    f"{_ZOO}/89696dacd6bd819dfd67dbb0935d778e0dc5cdc4/models/"
                    "object_tracking_dasiamrpn/object_tracking_dasiamrpn_kernel_r1_2021nov.onnx",
                ),
            ),
            ModelFile(
                "dasiamrpn_kernel_cls1.onnx",
                23603598,
                "d85b03e2aeded6cc9be945dfdc3ed6b8f4151f101e485037b6c5d5b36a6c4204",
                (
                    f"{_ZOO}/ad084e1d90070542793bd6622a59503d84e4d6f1/models/"
                    "object_tracking_dasiamrpn/object_tracking_dasiamrpn_kernel_cls1_2021nov.onnx",
                ),
            ),
        ),
    ),
    Model(
        name="yolo11n-int8",
        purpose=Purpose.DETECTOR,
        summary="YOLO11 nano, 320 pixels; AGPL, so not offered: bring your own if that suits you",
        licence="AGPL-3.0",
        origin="Ultralytics",
        family="yolov8",
        classes=_COCO,
        files=(
            ModelFile(
                "yolo11n_int8.onnx",
                2923970,
                "a513b3f4a008def6dbda3c4028cc7d030e18e1034614a9256d2b9e3f815ce1fe",
            ),
        ),
    ),
)
