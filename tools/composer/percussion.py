"""Unpitched instruments: each call returns one hit, (n,); `take` varies it from hit to hit."""

from __future__ import annotations

import numpy as np

from downbeat.tools.composer.effects import bandpass, drive, highpass, lowpass
from downbeat.tools.composer.waves import F64, count, fall, noise, pulse, seconds_axis, sine


def kick(take: int = 0, tight: bool = True) -> F64:
    """Return a bass drum: a falling sine and a click. `tight`: of a dance floor, else of a kit."""
    length = 0.32 if tight else 0.38
    times = seconds_axis(length)
    low, sweep = (48.0, 150.0) if tight else (62.0, 70.0)
    moving = low + sweep * np.exp(-times / 0.022) + 18.0 * np.exp(-times / 0.09)
    body = sine(moving, length) * fall(length, 0.13 if tight else 0.10, 0.0008)
    click = highpass(noise(0.008, 100 + take), 2_000.0) * fall(0.008, 0.0015, 0.0002)
    body[: len(click)] += (0.25 if tight else 0.4) * click
    return drive(1.2 * body, 1.4)


def snare(take: int = 0, tone_hz: float = 190.0, snappy: float = 1.0) -> F64:
    """Return a snare drum."""
    length = 0.26
    shell = sine(tone_hz, length) * fall(length, 0.05) + 0.6 * sine(1.62 * tone_hz, length) * fall(
        length, 0.035
    )
    wires = highpass(noise(length, 200 + take), 1_400.0) * fall(length, 0.075 * snappy)
    return drive(0.7 * shell + 0.42 * wires, 1.3)


def rim(take: int = 0) -> F64:
    """Return a stick on the rim."""
    length = 0.06
    tone = sine(1_720.0, length) + 0.7 * sine(840.0, length)
    stick = bandpass(noise(length, 300 + take), 1_500.0, 7_000.0)
    return 0.5 * (tone + 0.6 * stick) * fall(length, 0.009, 0.0003)


def clap(take: int = 0) -> F64:
    """Return hands: three short bursts and their tail."""
    length = 0.28
    hands = bandpass(noise(length, 400 + take), 800.0, 5_500.0)
    times = seconds_axis(length)
    envelope = 0.7 * np.where(times > 0.024, np.exp(-(times - 0.024) / 0.06), 0.0)
    for burst_s in (0.0, 0.009, 0.018):
        since = times - burst_s
        envelope = np.maximum(
            envelope, np.where(since >= 0.0, np.exp(-np.maximum(since, 0.0) / 0.004), 0.0)
        )
    return 0.9 * hands * envelope * fall(length, 1.0, 0.0005)


def hat(take: int = 0, open_s: float = 0.035) -> F64:
    """Return a hi-hat: metal, closed (short) or open (long)."""
    length = min(6.0 * open_s, 0.5)
    metal = sum(pulse(hz, length, 0.5) for hz in (2_050.0, 3_070.0, 3_690.0, 4_110.0, 5_430.0))
    sound = highpass(0.18 * metal + 0.7 * noise(length, 500 + take), 7_000.0)
    return 0.5 * sound * fall(length, open_s, 0.0005)


def crash(take: int = 0) -> F64:
    """Return a crash cymbal."""
    length = 2.2
    metal = sum(pulse(hz, length, 0.5) for hz in (1_030.0, 1_478.0, 2_236.0, 3_315.0, 4_612.0))
    sound = highpass(0.10 * metal + 0.6 * noise(length, 600 + take), 3_500.0)
    return 0.45 * sound * fall(length, 0.55, 0.002)


def ride(take: int = 0) -> F64:
    """Return a ride cymbal with its bow sound."""
    length = 0.6
    metal = sum(pulse(hz, length, 0.5) for hz in (2_830.0, 3_540.0, 4_470.0, 5_190.0))
    ping = sine(5_320.0, length) * fall(length, 0.05)
    sound = highpass(0.16 * metal + 0.25 * noise(length, 650 + take), 5_000.0)
    return 0.4 * (sound * fall(length, 0.16, 0.0005) + 0.3 * ping)


def tom(hz: float, take: int = 0) -> F64:
    """Return a tom of a pitch."""
    length = 0.42
    times = seconds_axis(length)
    moving = hz * (1.0 + 0.5 * np.exp(-times / 0.03))
    skin = lowpass(noise(length, 700 + take), 1_600.0) * fall(length, 0.025)
    return drive(sine(moving, length) * fall(length, 0.14) + 0.3 * skin, 1.2)


def cowbell(take: int = 0) -> F64:
    """Return a cowbell."""
    length = 0.22
    tone = pulse(562.0, length, 0.5) + pulse(845.0, length, 0.5, 0.2)
    return 0.35 * bandpass(tone, 480.0, 4_500.0) * (fall(length, 0.02) + 0.4 * fall(length, 0.07))


def claves(take: int = 0) -> F64:
    """Return two hard sticks."""
    length = 0.09
    return 0.7 * (sine(2_480.0, length) + 0.3 * sine(5_100.0, length)) * fall(length, 0.016, 0.0004)


def conga(kind: str, high: bool = True, take: int = 0) -> F64:
    """Return a conga stroke: "open", "slap" or "touch"."""
    hz = 245.0 if high else 178.0
    length = 0.34 if kind == "open" else 0.12
    times = seconds_axis(length)
    moving = hz * (1.0 + 0.10 * np.exp(-times / 0.02))
    skin = bandpass(noise(length, 800 + take), 400.0, 3_500.0)
    if kind == "open":
        return sine(moving, length) * fall(length, 0.11) + 0.16 * skin * fall(length, 0.01)
    if kind == "slap":
        return 0.35 * sine(1.6 * moving, length) * fall(length, 0.02) + 0.55 * skin * fall(
            length, 0.018
        )
    return 0.3 * sine(moving, length) * fall(length, 0.02) + 0.18 * skin * fall(length, 0.012)


def timbale(high: bool = True, take: int = 0) -> F64:
    """Return a timbale: a metal shell drum."""
    length = 0.3
    hz = 410.0 if high else 300.0
    tone = sine(hz, length) + 0.6 * sine(1.59 * hz, length) + 0.4 * sine(2.14 * hz, length)
    stick = bandpass(noise(length, 900 + take), 2_000.0, 8_000.0) * fall(length, 0.012)
    return 0.5 * tone * fall(length, 0.07) + 0.35 * stick


def shell(take: int = 0) -> F64:
    """Return the stick on a timbale's shell (cascara)."""
    length = 0.06
    tone = sine(3_150.0, length) + 0.6 * sine(4_720.0, length) + 0.4 * sine(1_480.0, length)
    return 0.35 * tone * fall(length, 0.009, 0.0004)


def shaker(take: int = 0, length: float = 0.09) -> F64:
    """Return maracas: grains that swell and stop."""
    envelope = np.hanning(2 * count(length))[: count(length)] ** 2
    tail = fall(0.05, 0.012)
    grains = bandpass(noise(length + 0.05, 950 + take), 4_500.0, 12_000.0)
    return 0.6 * grains * np.concatenate([envelope, tail * envelope[-1]])[: len(grains)]


def guiro(take: int = 0) -> F64:
    """Return a scraped gourd."""
    length = 0.2
    times = seconds_axis(length)
    teeth = 0.5 + 0.5 * np.sign(np.sin(2.0 * np.pi * 82.0 * times * (1.0 + 0.6 * times)))
    scrape = bandpass(noise(length, 970 + take), 1_800.0, 7_500.0)
    return 0.4 * scrape * lowpass(teeth, 900.0, order=1) * np.hanning(len(times)) ** 0.5


def riser(length_s: float, take: int = 0) -> F64:
    """Return wind that rises to a section change."""
    times = seconds_axis(length_s)
    share = times / length_s
    dark = bandpass(noise(length_s, 1_000 + take), 300.0, 1_500.0)
    bright = bandpass(noise(length_s, 1_001 + take), 2_500.0, 11_000.0)
    wind = (1.0 - share) * dark + share**2 * bright
    return 0.6 * wind * share**2 * np.clip((length_s - times) / 0.02, 0.0, 1.0)


def wind(length_s: float, take: int = 0) -> F64:
    """Return a howling night wind."""
    times = seconds_axis(length_s)
    howl = 0.5 + 0.5 * np.sin(2.0 * np.pi * 0.23 * times + 1.0)
    low = bandpass(noise(length_s, 1_100 + take), 250.0, 420.0)
    high = bandpass(noise(length_s, 1_101 + take), 520.0, 800.0)
    shape = np.minimum(times / 1.2, 1.0) * np.clip((length_s - times) / 1.5, 0.0, 1.0)
    return 0.8 * shape * ((1.0 - howl) * low + howl * high)


# ------------------------------------------------------------------ hits by name, for the desk


def kit_kick(take: int) -> F64:
    """Return the bass drum of a drum kit."""
    return kick(take, tight=False)


def open_hat(take: int) -> F64:
    """Return an open hi-hat."""
    return hat(take, 0.1)


def tom_high(take: int) -> F64:
    """Return the small tom."""
    return tom(180.0, take)


def tom_middle(take: int) -> F64:
    """Return the middle tom."""
    return tom(138.0, take)


def tom_low(take: int) -> F64:
    """Return the floor tom."""
    return tom(95.0, take)


def conga_touch(take: int) -> F64:
    """Return fingers on the high conga."""
    return conga("touch", True, take)


def conga_slap(take: int) -> F64:
    """Return a slap on the high conga."""
    return conga("slap", True, take)


def conga_high(take: int) -> F64:
    """Return an open stroke on the high conga."""
    return conga("open", True, take)


def conga_low(take: int) -> F64:
    """Return an open stroke on the low conga."""
    return conga("open", False, take)


def timbale_high(take: int) -> F64:
    """Return the small timbale."""
    return timbale(True, take)


def timbale_low(take: int) -> F64:
    """Return the large timbale."""
    return timbale(False, take)
