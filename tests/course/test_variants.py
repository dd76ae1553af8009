"""SweepNet's recipes side by side: each trains by its own settings, and their curves meet in one table."""

import csv

from course import variants
from omnistereo_lib.train import RECIPES
from omnistereo_lib.train.loop import COLUMNS, LOG, write_csv


def test_every_variant_is_trained_by_its_recipe_and_compared(tmp_path, monkeypatch):
    trained = {}

    def train(recipe, out):
        out.mkdir(parents=True)
        trained[out.name] = recipe
        validation = [["", ""] if step % 2 == 0 else [1, 0.5 / (step + len(trained))] for step in range(4)]
        write_csv(out / LOG, COLUMNS, [[step, 1, 1, 0.1, 0, *validation[step]] for step in range(4)])

    monkeypatch.setattr(variants, "train", train)
    path = variants.compare_sweepnets(tmp_path, ["steps=4", "width=160"])
    teaching = RECIPES["sweepnet"]["teaching"].with_overrides(["steps=4", "width=160"])
    assert trained["ours"] == teaching and not trained["no_batch_norm"].batch_norm
    assert trained["SGD"].optimizer == "sgd" and trained["SGD"].batch_norm == teaching.batch_norm
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["step", *variants.VARIANTS] and [row[0] for row in rows] == ["2", "4"]
    assert rows[1][1:] == [f"{0.5 / (3 + k):.4g}" for k in range(1, 5)]
