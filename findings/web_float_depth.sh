#!/usr/bin/env bash
# A float32 depth TIFF on a web page: in three.js each metre begins again at black; its EXRLoader refuses a channel Z.
# Guessed before: that TIFFLoader gives a float texture, as EXRLoader does, or refuses, and that Z is read as depth.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" tifffile==2026.3.3 imagecodecs==2026.3.6 OpenEXR==3.5.3 numpy==2.4.6
cd "$site" && npm install --silent --no-audit --no-fund three@0.187.0 geotiff@3.0.5 tiff@7.1.3
PYTHONPATH=$site python3 - <<'PY'
import numpy as np, OpenEXR, tifffile
depth = np.array([[0.5, 0.75, 1, 1.25], [1.5, 2.5, 9.75, 19]], np.float32)
tifffile.imwrite("plain.tiff", depth, compression="zlib")
tifffile.imwrite("predicted.tiff", depth, compression="zlib", predictor=3)  # as GDAL's PREDICTOR=3
for channel in "YZ":
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {channel: depth.copy()}).write(f"{channel}.exr")
PY
cat > read.mjs <<'JS'
import assert from "node:assert";
import fs from "node:fs";
import { fromFile } from "geotiff";
import { REVISION, FloatType } from "three";
import { EXRLoader } from "three/examples/jsm/loaders/EXRLoader.js";
import { TIFFLoader } from "three/examples/jsm/loaders/TIFFLoader.js";
import { decode } from "tiff";
const depth = [0.5, 0.75, 1, 1.25, 1.5, 2.5, 9.75, 19];
const read = (path) => new Uint8Array(fs.readFileSync(path)).buffer;
const red = (data) => Array.from(data).filter((_, k) => k % 4 === 0);
const attempt = async (call) => { try { return await call(); } catch (error) { return String(error); } };
console.log(`written${"".padEnd(22)}`, ...depth, "m");
const found = {};
for (const name of ["plain", "predicted"]) {
  const readers = {
    [`three r${REVISION} TIFFLoader`]: () => red(new TIFFLoader().parse(read(`${name}.tiff`)).data),
    "geotiff 3.0.5": async () => Array.from((await (await (await fromFile(`${name}.tiff`)).getImage()).readRasters())[0]),
    "tiff 7.1.3": () => Array.from(decode(read(`${name}.tiff`))[0].data),
  };
  found[name] = [];
  for (const [reader, call] of Object.entries(readers)) {
    found[name].push(await attempt(call));
    console.log(name.padEnd(10), reader.padEnd(18), ...[found[name].at(-1)].flat());
  }
}
const exr = (path) => attempt(() => red(new EXRLoader().setDataType(FloatType).parse(read(path)).data));
const [z, y] = [await exr("Z.exr"), await exr("Y.exr")];
console.log("EXRLoader, channel Z:", z, "| channel Y, from the lowest row:", ...y);
const [three, geotiff, tiff] = found.plain;
assert.deepEqual(three, depth.map((d) => Math.round(d * 255) % 256));
assert.deepEqual([geotiff, tiff, found.predicted[1]], [depth, depth, depth]);
assert(found.predicted[0].slice(0, 7).every((value) => value === 0) && found.predicted[2].includes("predictor"));
assert(z.includes("unsupported data channels"));
assert.deepEqual(y, [...depth.slice(4), ...depth.slice(0, 4)]);
JS
node read.mjs
