"""SweepNet, the matching cost of whole spherical images (paper, Section III-C and Table I)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import relu_
from torch.nn.utils import fuse_conv_bn_weights

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import PairNetwork, full_precision


class SweepNet(PairNetwork):
    """The network of the paper (Table I): two spherical images → cost map, 0 = match, 1 = no match.

    757,729 parameters. A cost depends on the 81 × 81 pixels around it: 24° at 1200, 91° at 320.

    Args:
        batch_norm: Batch normalisation after every layer except the last, for training. Table I has
            none, the authors' released code has it. `fuse_batch_norm` removes it.
        wrap: True: every layer continues around the ±180° seam. False: as Table I prints, circular
            columns only for the input and zeros behind it: the seam shows.

    >>> sum(parameter.numel() for parameter in osl.SweepNet().parameters())
    757729
    """

    bundled = "sweepnet"
    stride, padding, feature_halo, match_halo = 2, (0, 2), 17, 2
    layers: Any  # ModuleDict; torch does not type its entries
    norms: Any

    def __init__(self, batch_norm: bool = False, wrap: bool = True) -> None:
        super().__init__()
        self.wrap = wrap
        # The layers as Table I names them.
        self.layers = nn.ModuleDict()
        self.layers["conv1"] = nn.Conv2d(1, 32, 5, stride=2, padding=(2, 0))
        for k in range(2, 19):
            self.layers[f"conv{k}"] = nn.Conv2d(32, 32, 3, padding=1)
        self.layers["conv19"] = nn.Conv2d(64, 128, 3, padding=1)
        self.layers["deconv1"] = nn.ConvTranspose2d(
            128, 128, 3, stride=2, padding=1, output_padding=1
        )
        self.layers["conv20"] = nn.Conv2d(128, 128, 3, padding=1)
        # fc1 … fc5: 1 × 1 convolutions, as products on a list of pixels
        self.layers["fc1"] = nn.Linear(128, 256)
        for k in (2, 3, 4):
            self.layers[f"fc{k}"] = nn.Linear(256, 256)
        self.layers["fc5"] = nn.Linear(256, 1)
        # Random weights, and batch norms where they are asked for.
        self.norms = nn.ModuleDict()
        for name, layer in self.layers.items():
            nn.init.zeros_(layer.bias)
            # This keeps the scale through ReLU layers; fc5 starts undecided.
            if name != "fc5":
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            if batch_norm and name != "fc5":
                kind = nn.BatchNorm1d if isinstance(layer, nn.Linear) else nn.BatchNorm2d
                # None: plain means, see `train`
                self.norms[name] = kind(layer.bias.numel(), momentum=None)
                # The norm subtracts any bias and has its own.
                layer.bias = None

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""
        return {"batch_norm": len(self.norms) > 0, "wrap": self.wrap}

    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas with an odd side: conv1 halves them."""
        if H % 2 or W % 2:
            raise OmnistereoError(
                f"panorama of {W} × {H} pixels; SweepNet halves it, so both sides must be even:"
                f" ask for {W + W % 2} × {H + H % 2}"
            )

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the cost map of two images: conv1 … conv18 of each, conv19 … fc5, a sigmoid.

        Args:
            left, right (tensors, shape (B, H, W)): Gray spherical images of zero mean and unit
                variance (`SphereSweep.normalize_images`), 0 where unseen.

        Returns:
            tensor, shape (B, H, W): Cost in [0, 1], 0 = match; with `wrap` circular in θ.
        """
        H, W = left.shape[1:]
        self.check_size(H, W)
        # Columns are repeated beyond the seam, then cut off.
        halo = self.feature_halo + self.match_halo if self.wrap else 0
        left, right = (self.pad_columns(image, -halo, W // 2 + halo) for image in (left, right))
        pixels = self.match_features(self.extract_features(left), self.extract_features(right))
        return torch.sigmoid(self.score_pixels(pixels[:, :, 2 * halo : 2 * halo + W]))

    def extract_features(self, images: Tensor) -> Tensor:
        """Run conv1 … conv18 on padded images (B, H, w + 4): (B, 32, H/2, w/2)."""
        # The texture of an image may be faint beside its brightness.
        with full_precision(images):
            x = self._run("conv1", images[:, None])
        # Eight residual blocks of two convolutions: the second one adds the block's input.
        for k in range(2, 18, 2):
            x = self._run(f"conv{k + 1}", self._run(f"conv{k}", x), add=x)
        return self._run("conv18", x)

    def match_features(self, left: Tensor, right: Tensor) -> Tensor:
        """Run conv19, deconv1 and conv20 on the features of two cameras: (B, H, w, 128)."""
        x = torch.cat([left, right], 1)
        for name in ("conv19", "deconv1", "conv20"):
            x = self._run(name, x)
        return x.permute(0, 2, 3, 1)

    def score_pixels(self, pixels: Tensor) -> Tensor:
        """Run fc1 … fc5 on pixels (…, 128): the logit of a mismatch, shape (…)."""
        x = pixels.flatten(0, -2)
        for name in ("fc1", "fc2", "fc3", "fc4"):
            x = self._run(name, x)
        with full_precision(x):
            return self.layers["fc5"](x.to(self.layers["fc5"].weight.dtype)).view(pixels.shape[:-1])

    def _run(self, name: str, x: Tensor, add: Tensor | None = None) -> Tensor:
        """Run a layer, its batch norm if there is one, add the block's input, and ReLU."""
        x = self.layers[name](x)
        if name in self.norms:
            x = self.norms[name](x)
        return relu_(x if add is None else x + add)

    @torch.no_grad()
    def fuse_batch_norm(self) -> SweepNet:
        """Return a network without batch norms that computes what this one does in evaluation."""
        plain = SweepNet(wrap=self.wrap)
        for name, layer in self.layers.items():
            weight, bias = layer.weight, layer.bias
            if name in self.norms:
                norm, transposed = self.norms[name], isinstance(layer, nn.ConvTranspose2d)
                statistics = norm.running_mean, norm.running_var, norm.eps, norm.weight, norm.bias
                weight, bias = fuse_conv_bn_weights(weight, bias, *statistics, transposed)
            plain.layers[name].weight.copy_(weight)
            plain.layers[name].bias.copy_(bias)
        return plain.to(self.layers["fc5"].weight.device).eval()
