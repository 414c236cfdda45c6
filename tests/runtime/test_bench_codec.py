"""The codec's benchmark measures what it says."""

from downbeat.runtime.bench_codec import CodecRow, bench_codec


def test_benchmark_covers_both_directions_of_the_high_rate_messages():
    rows = bench_codec(number=10, repeat=1)
    assert [row.name for row in rows] == [
        f"{name} {direction}"
        for name in ("g1_low_state_t", "g1_low_cmd_t", "control_status_t")
        for direction in ("encode", "decode")
    ]
    assert all(row.ours_us > 0.0 and row.lcm_gen_us > 0.0 for row in rows)


def test_ratio_is_how_many_times_faster_ours_is():
    assert CodecRow("x", 2.0, 5.0).ratio == 2.5
