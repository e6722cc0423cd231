"""Colours as people with colour blindness see them, and how far looks of symbols are apart.

Run as a script it prints the least distances, and writes what each kind of viewer sees of pictures:
``python tests/support/pictures/color_vision.py a.png b.png``.
"""

import sys
from pathlib import Path

import numpy as np

from capsyn.policies.colors import TILE, symbol_looks, tiles

VIEWERS = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
         [0.004733, 0.691367, 0.303900]]
    ),
}  # fmt: skip
"""Of linear colours; Machado, Oliveira and Fernandes, "A physiologically-based model for simulation
of color vision deficiency", IEEE TVCG 15 (2009), severity 1."""
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip
WHITE = np.array([0.95047, 1.0, 1.08883])
BLUR = 0.7
"""Deviation of the blur with which marks are seen [dots]."""


def parts(color):
    """Return red, green and blue of ``#rrggbb``, from 0 to 1."""
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def seen(colors, viewer):
    """Return colours (..., 3), from 0 to 1, as a viewer sees them."""
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ VIEWERS[viewer].T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def lab(colors):
    """Return colours (..., 3) in CIELAB, where a distance of 2.3 can just be noticed."""
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    xyz = linear @ TO_XYZ.T / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def distances(looks, viewer):
    """Return how far looks are apart, (K, K): 0 on the diagonal.

    It is the root of the mean square of the distances of their dots in CIELAB, where the marks are
    shifted so that it is least.
    """
    from scipy.ndimage import gaussian_filter

    textures = []
    for look in looks:
        marked = tiles()[look.marks][..., None]
        texture = np.where(marked, parts(look.ink), parts(look.color))
        textures.append(lab(seen(gaussian_filter(texture, (BLUR, BLUR, 0), mode="wrap"), viewer)))
    textures = np.array(textures)
    waves, squares = np.fft.rfft2(textures, axes=(1, 2)), (textures**2).sum(axis=(1, 2, 3))
    found = np.zeros((len(looks), len(looks)))
    for k in range(len(looks)):
        products = (waves[k].conj() * waves[k + 1 :]).sum(axis=-1)
        shifted = np.fft.irfft2(products, (TILE, TILE), axes=(1, 2)).max(axis=(1, 2))
        squared = squares[k] + squares[k + 1 :] - 2 * shifted
        found[k, k + 1 :] = found[k + 1 :, k] = np.sqrt(np.maximum(squared, 0) / TILE**2)
    return found


def least(looks, viewer, steps=None):
    """Return the least distance between looks; `steps` of numbers say which are neighbours."""
    found = distances(looks, viewer)
    if steps is None:
        return found[np.triu_indices(len(looks), 1)].min()
    return min(found.diagonal(step).min() for step in steps if step < len(looks))


def main(paths):
    """Print the least distances, and write pictures as they are seen."""
    from matplotlib.image import imread, imsave

    powers = [2**k for k in range(8)]
    cases = {"8": (8, None), "27": (27, None), "27, one setting of three": (27, (1, 3, 9)),
             "64": (64, None), "256": (256, None), "256, one bit": (256, powers)}  # fmt: skip
    for name, (count, steps) in cases.items():
        found = {viewer: least(symbol_looks(count), viewer, steps) for viewer in VIEWERS}
        print(f"{name:26}", *(f"{viewer} {value:5.1f}" for viewer, value in found.items()))
    for path in map(Path, paths):
        image = imread(path)[..., :3]
        for viewer in list(VIEWERS)[1:]:
            imsave(path.with_name(f"{path.stem}-{viewer}.png"), seen(image, viewer))


if __name__ == "__main__":
    main(sys.argv[1:])
