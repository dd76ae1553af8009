from omnistereo_lib.bench import Row, bench_sgm, best_of, table


def test_sgm_is_compared_on_the_same_job():
    (row,) = bench_sgm(width=160, height=20, num=32, repeats=1)
    assert row.ours_s > 0
    assert row.theirs_s > 0
    assert "100.00% of 800 rays" in row.note


def test_best_of_takes_turns_and_leaves_out_the_first_round():
    calls = []
    ours, theirs = best_of(2, lambda: calls.append("ours"), lambda: calls.append("theirs"))
    assert calls == ["ours", "theirs"] * 3
    assert min(ours, theirs) >= 0


def test_table_shows_the_ratio():
    text = table([Row("a", 0.010, 0.020, "note"), Row("longer", 1.0, 0.5)])
    assert [line.split() for line in text.splitlines()[1:]] == [
        ["a", "10.0", "20.0", "0.50", "note"],
        ["longer", "1000.0", "500.0", "2.00"],
    ]
