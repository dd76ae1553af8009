"""The students' right answers, in NumPy, are the definition, on the checkers' inputs."""

from importlib import import_module

import numpy as np
import pytest
import torch

from omnistereo_lib import reference


def correlation(f):
    """Features (cameras, …, 32), NaN where unseen, as maps and pixels on them."""
    rows, columns = torch.meshgrid(*map(torch.arange, f.shape[1:3]), indexing="ij")
    pixels = [
        torch.stack([columns, rows], -1).double().where(~one[..., :1].isnan(), torch.nan)
        for one in f
    ]
    return reference.correlate([one.nan_to_num().permute(2, 0, 1) for one in f], pixels, groups=8)[
        :8
    ].permute(1, 2, 0)


def cost_volume(images, cameras, poses, theta, phi, radii, pair_cost):
    theta, phi = torch.meshgrid(theta, phi, indexing="xy")
    rays = torch.stack([phi.cos() * theta.sin(), phi.sin(), phi.cos() * theta.cos()], dim=-1)
    center, layers = torch.from_numpy(np.mean([pose.t for pose in poses], axis=0)), []
    for radius in radii:
        warped = [
            warp(torch.from_numpy(image), *of, center + radius * rays)
            for image, *of in zip(images, cameras, poses, strict=True)
        ]
        costs = [pair_cost(warped[i - 1], warped[i]) for i in range(len(warped))]
        layers.append(reference.mean_over_pairs(torch.stack(costs)))
    return torch.stack(layers, dim=-1)


def warp(image, camera, pose, points):
    return reference.warp(
        image, camera, pose, points, torch.ones(points.shape[:-1], dtype=torch.float64)
    )


DEFINITIONS = {
    "nb03.rays_of_pixels": lambda columns, rows, W, H, phi_deg: reference.rays(W, H, phi_deg)[
        rows, columns
    ],
    "nb03.pixels_of_points": lambda points, camera, pose: reference.project(
        torch.from_numpy(pose.inverse() @ points.numpy()), camera
    ),
    "nb03.look_up": lambda image, pixels: reference.sample(image[None].double(), pixels)[0],
    "nb04.zncc_costs": lambda a, b, radius: reference.zncc(a[None], b[None], 2 * radius + 1)[0],
    "nb04.mean_of_pairs": reference.mean_over_pairs,
    "nb04.winner": lambda costs: reference.winner(costs, subindex=False),
    "nb05.step": lambda cost, before, p1, p2: cost + reference.message(before, p1, p2),
    "nb05.sum_of_paths": lambda volume, p1, p2, directions: reference.sgm(volume, p1, p2),
    "nb05.refined": lambda costs: reference.winner(costs, subindex=True),
    "nb16.correlation": correlation,
    "nb06.project": lambda camera, points: reference.project(points, camera),
    "nb06.warp": warp,
    "nb06.cost_volume": cost_volume,
}


@pytest.mark.parametrize("name", DEFINITIONS)
@pytest.mark.parametrize("k", range(3))
def test_an_answer_is_the_definition(name, k):
    module, function = name.split(".")
    check = getattr(import_module(f"course.exercises.{module}"), f"check_{function}")
    inputs = check.draw(np.random.default_rng(k), k)
    tensors = [torch.as_tensor(one) if isinstance(one, np.ndarray) else one for one in inputs]
    np.testing.assert_allclose(
        check.answer(*inputs), DEFINITIONS[name](*tensors), rtol=1e-6, atol=1e-7
    )
