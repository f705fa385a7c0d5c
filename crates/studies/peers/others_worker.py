"""pycolmap (VLFeat) or scikit-image as a worker, named by the first argument: JSON lines in and out, as speed.py asks."""

import json
import sys
import time

import numpy as np
from PIL import Image


def vlfeat():
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.sift.max_num_features = 1_000_000
    engine = pycolmap.Sift(options, device=pycolmap.Device.cpu)
    return f"pycolmap {pycolmap.__version__} (VLFeat)", lambda pixels: len(engine.extract(pixels)[0])


def skimage():
    import skimage
    from skimage.feature import SIFT

    def work(pixels: np.ndarray) -> int:
        engine = SIFT()
        engine.detect_and_extract(pixels)
        return len(engine.keypoints)

    return f"scikit-image {skimage.__version__}", work


name, work = {"vlfeat": vlfeat, "skimage": skimage}[sys.argv[1]]()
for line in sys.stdin:
    try:
        request = json.loads(line)
        if request["piece"] == "hello":
            reply = {"name": name, "version": ""}
        else:
            pixels, ms, count = np.array(Image.open(request["image"])), [], 0
            for _ in range(request["repetitions"]):
                start = time.perf_counter()
                count = work(pixels)
                ms.append((time.perf_counter() - start) * 1e3)
            reply = {"ms": ms, "count": count}
    except Exception as error:  # whatever goes wrong is the driver's to tell
        reply = {"error": f"{type(error).__name__}: {error}"}
    print(json.dumps(reply), flush=True)
