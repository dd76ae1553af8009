#!/usr/bin/env bash
# A transposed, mirrored or thinned array, or a conjugate: safetensors stores other numbers, without a word.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" safetensors==0.8.0 numpy==2.4.6 torch==2.13.0 packaging==26.3
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, safetensors, torch
import safetensors.numpy as of_numpy, safetensors.torch as of_torch
image, pair = np.arange(6.0).reshape(2, 3), torch.tensor([1 + 2j, 3 - 1j])
views = {"transposed": image.T, "mirrored": image[:, ::-1], "every second": image[:, ::2]}
views |= {"conjugate": pair.conj(), "imaginary part of it": pair.conj().imag.contiguous(), "contiguous": image.copy()}
print("safetensors", safetensors.__version__, "numpy", np.__version__, "torch", torch.__version__)
wrong = []
for name, view in views.items():
    module = of_torch if isinstance(view, torch.Tensor) else of_numpy
    module.save_file({"a": view}, "a.safetensors")
    back = module.load_file("a.safetensors")["a"]
    wrong += [] if np.array_equal(np.asarray(back), view.resolve_conj().numpy() if module is of_torch and view.is_complex()
                                  else np.asarray(view)) else [name]
    print(f"{name:22}", np.asarray(back).tolist(), "" if name in wrong else "(right)")
assert wrong == ["transposed", "mirrored", "every second", "conjugate"], wrong
PY
