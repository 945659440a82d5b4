"""Pictures of light in spherical harmonics: as the eye sees it, and on the field's three spheres.

The spheres are a mirror, matte silver (roughness 0.3271) and grey diffuse, seen by an orthographic camera that looks
horizontally along +Y: +X is to the right, +Z is up, and the mirror's centre shows what lies behind the camera, at -Y.
Every sphere reflects all light (no tint, no loss, no shadow): constant light of radiance L shows L everywhere, and
the three differ only in how far they spread light.

What each pixel shows is a linear function of the nine coefficients, so the whole picture is one matrix product, fast
enough for a metric over thousands of lights. Rejected: rendering the spheres, which needs a renderer and has noise.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.panorama import evaluate_panorama, panorama_directions
from xihenet.records import ArrayBool, ArrayF64, ArrayU8, UnitSphereCloud
from xihenet.sh import cosine_lobe
from xihenet.sh_basis import basis, checked_sh, per_coefficient
from xihenet.sphere import AnchorLattice

SPHERES = ("mirror", "matte silver", "grey diffuse")
SILVER_ROUGHNESS = 0.3271  # Of the usual three-sphere protocol
BACKGROUND = 0.21  # sRGB grey around the pictures: dark enough for dim light, bright enough for black to stand out
VIEW = np.array([0.0, 1.0, 0.0])
ORDER = 2
N_LOBE_NODES = 128
N_SUBPIXELS = 2


def sphere_mask(size: int) -> ArrayBool:
    """(size, size) bool: the pixels whose centres lie inside the circle that fills the picture; row 0 is the top.

    ValueError for a size below 1.
    """
    x, z = _picture_plane(size)
    return np.less(x * x + z * z, 1)


@lru_cache(maxsize=4)
def sphere_transfer(size: int) -> ArrayF64:
    """The linear map from coefficients to what the pixels of the three spheres show, each `size` pixels wide and high.

    (3, P, 9) float64, read-only, in the order of `SPHERES`; P are the pixels of `sphere_mask(size)` in row order.
    `sphere_transfer(size) @ sh_radiance` is (3, P, 3): radiance of the reflected direction, that light spread by
    `silver_lobe`, and irradiance / pi. ValueError for a size below 1.
    """
    inside = sphere_mask(size)
    x, z = (plane[inside] for plane in _picture_plane(size))
    normals = np.stack([x, -np.sqrt(1 - x * x - z * z), z], axis=1)
    reflected = VIEW - 2 * (normals @ VIEW)[:, None] * normals
    mirror, diffuse = basis(reflected, ORDER), cosine_lobe(ORDER) / np.pi
    transfer: ArrayF64 = np.stack(
        [mirror, mirror * per_coefficient(silver_lobe()), basis(normals, ORDER) * per_coefficient(diffuse)]
    )
    transfer.flags.writeable = False
    return transfer


def silver_lobe() -> ArrayF64:
    """How much of each band, 0 to 2, the matte silver sphere keeps: (3,), 1 for band 0.

    The microfacet lobe of GGX (Walter et al. 2007, alpha = roughness^2) about the reflected direction, as it is for
    light and eye along the normal, weighted by the cosine of the light: the prefiltering of the split-sum method
    (Karis 2013). At the angle whose cosine is c the half vector has cos^2 = (1 + c) / 2, so the lobe is
    c / (1 - (1 - alpha^2) (1 + c) / 2)^2, and a band keeps the lobe's mean of its Legendre polynomial. That the lobe
    stretches at grazing angles is left out.
    """
    nodes, weights = np.polynomial.legendre.leggauss(N_LOBE_NODES)  # type: ignore[no-untyped-call]
    c = (nodes + 1) / 2
    alpha_squared = SILVER_ROUGHNESS**4
    lobe = weights * c / (1 - (1 - alpha_squared) * (1 + c) / 2) ** 2
    legendre = np.stack([np.ones_like(c), c, (3 * c * c - 1) / 2])
    return (legendre * lobe).sum(axis=1) / lobe.sum()


def three_spheres(sh_radiance: ArrayLike, size: int) -> ArrayF64:
    """The mirror, the matte silver and the grey diffuse sphere under (9, 3) radiance coefficients.

    (3, size, size, 3) float64 linear radiance, 0 outside of `sphere_mask(size)`; not clamped, so values may be
    negative. ValueError for another shape, NaN or infinity, or a size below 1.
    """
    pictures = np.zeros((len(SPHERES), size, size, 3))
    pictures[:, sphere_mask(size)] = sphere_transfer(size) @ _checked_order_2(sh_radiance)
    return pictures


def light_picture(sh_radiance: ArrayLike, *, panorama_height: int = 256) -> ArrayU8:
    """One picture of a light: its panorama, twice as wide as high, and the three spheres in a row beneath it.

    `sh_radiance` (9, 3) are radiance coefficients carrying an exposure, as estimates do. (H, W, 3) uint8 sRGB on
    neutral grey, a sixteenth of the height around and between the pictures, as Blender's Standard view shows it:
    clipped at 1, negative light as black. ValueError for another shape, NaN or infinity.
    """
    light = _checked_order_2(sh_radiance)
    width, margin = 2 * panorama_height, panorama_height // 16
    size = (width - 2 * margin) // 3
    grey = float(srgb_to_linear(BACKGROUND))
    page = np.full((panorama_height + size + 3 * margin, width + 2 * margin, 3), grey)
    page[margin : margin + panorama_height, margin : margin + width] = evaluate_panorama(light, panorama_height, width)
    fine = N_SUBPIXELS * size  # for smooth edges
    shown = np.where(sphere_mask(fine)[..., None], np.clip(three_spheres(light, fine), 0, 1), grey)
    # Not `mean` over both axes at once, which takes several times as long.
    of_rows = shown.reshape(len(SPHERES), size, N_SUBPIXELS, fine, 3).mean(axis=2)
    spheres = of_rows.reshape(len(SPHERES), size, size, N_SUBPIXELS, 3).mean(axis=3)
    top = 2 * margin + panorama_height
    for index, sphere in enumerate(spheres):
        # The last sphere ends where the panorama ends, also where a third is no whole number of pixels.
        left = margin + round(index * (width - size) / 2)
        page[top : top + size, left : left + size] = sphere
    return np.rint(linear_to_srgb(page) * 255).astype(np.uint8)


def seen_picture(cloud: UnitSphereCloud, height: int) -> ArrayU8:
    """(height, 2 height, 3) uint8 sRGB: a panorama of what a cloud knows, grey for anchors that are not set.

    ValueError for a height below 1.
    """
    lattice = AnchorLattice(len(cloud))
    anchors = lattice.nearest(panorama_directions(height, 2 * height).reshape(-1, 3))
    shown = np.where(cloud.is_set[:, None], cloud.srgb, BACKGROUND)[anchors]
    return np.rint(shown.reshape(height, 2 * height, 3) * 255).astype(np.uint8)


def _picture_plane(size: int) -> tuple[ArrayF64, ArrayF64]:
    """x to the right and z upwards, each (size, size), of the pixel centres; the picture's edges are at -1 and 1."""
    if size < 1:
        raise ValueError(f"three spheres: expected pictures of at least one pixel, got a size of {size}")
    across = (2 * np.arange(size) + 1) / size - 1
    x, z = np.meshgrid(across, -across)
    return x, z


def _checked_order_2(sh_radiance: ArrayLike) -> ArrayF64:
    light, order = checked_sh(sh_radiance)
    if order != ORDER:
        raise ValueError(f"three spheres: expected coefficients of shape (9, 3), got {light.shape}")
    return light
