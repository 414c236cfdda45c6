"""Pitched instruments: each is a function of frequency [Hz] and length [s] that returns (n,).

A note's loudness is the desk's business; lengths include the release.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from downbeat.tools.composer.effects import bandpass, drive, highpass, lowpass, peak
from downbeat.tools.composer.waves import (
    F64,
    RATE_HZ,
    adsr,
    chorus_of_saws,
    count,
    fall,
    noise,
    pulse,
    saw,
    seconds_axis,
    sine,
)


def _opening(bright: F64, dark_hz: float, envelope: F64) -> F64:
    """Fade from a dark copy to the bright sound: a filter envelope without a moving filter."""
    dark = lowpass(bright, dark_hz)
    return dark + envelope * (bright - dark)


# ------------------------------------------------------------------ synthesisers


def super_lead(hz: float, seconds: float) -> F64:
    """Return a wide, bright supersaw."""
    length = seconds + 0.12
    tone = chorus_of_saws(hz, length, 5, 14.0) + 0.35 * saw(0.5 * hz, length, 0.3)
    tone = highpass(lowpass(tone, min(9_000.0, 14.0 * hz + 1_500.0)), 0.6 * hz)
    return 0.5 * tone * adsr(length, 0.006, 0.25, 0.75, 0.12)


def soft_lead(hz: float, seconds: float) -> F64:
    """Return a hollow pulse lead with a late vibrato, close to a clarinet."""
    length = seconds + 0.06
    times = seconds_axis(length)
    depth = 0.006 * np.clip((times - 0.18) / 0.2, 0.0, 1.0)
    moving = hz * (1.0 + depth * np.sin(2.0 * np.pi * 5.6 * times))
    tone = sum(sine(number * moving, length) / number**1.15 for number in (1, 3, 5, 7, 9))
    tone = tone + 0.25 * sine(2.0 * moving, length)
    return 0.6 * lowpass(tone, 5_000.0) * adsr(length, 0.012, 0.3, 0.8, 0.06)


def pad(hz: float, seconds: float) -> F64:
    """Return a slow, warm pad."""
    length = seconds + 0.35
    tone = lowpass(chorus_of_saws(hz, length, 4, 11.0), 2_600.0)
    return 0.32 * tone * adsr(length, 0.18, release_s=0.4)


def pluck(hz: float, seconds: float) -> F64:
    """Return a short synthetic pluck for arpeggios."""
    length = max(seconds, 0.28)
    bright = 0.5 * pulse(hz, length, 0.3) + 0.5 * saw(1.003 * hz, length, 0.4)
    tone = _opening(lowpass(bright, 8_000.0), 1.5 * hz + 300.0, fall(length, 0.06))
    return 0.6 * tone * fall(length, 0.16)


def synth_bass(hz: float, seconds: float) -> F64:
    """Return a saw bass with a sine below it."""
    length = seconds + 0.02
    bright = saw(hz, length) + 0.5 * pulse(1.004 * hz, length, 0.35, 0.2)
    tone = _opening(lowpass(bright, 2_400.0), 260.0, fall(length, 0.11))
    tone = drive(0.55 * tone, 1.6) + 0.55 * sine(hz, length)
    return 0.75 * tone * adsr(length, 0.004, 0.2, 0.85, 0.02)


def theremin(hz: float, seconds: float) -> F64:
    """Return a wailing sine that slides into its pitch."""
    length = seconds + 0.15
    times = seconds_axis(length)
    slide = 2.0 ** (-np.exp(-times / 0.05) * 2.0 / 12.0)
    vibrato = 1.0 + 0.014 * np.clip(times / 0.3, 0.0, 1.0) * np.sin(2.0 * np.pi * 6.1 * times)
    moving = hz * slide * vibrato
    tone = (
        sine(moving, length) + 0.3 * sine(2.0 * moving, length) + 0.1 * sine(3.0 * moving, length)
    )
    return 0.55 * tone * adsr(length, 0.06, release_s=0.15)


# ------------------------------------------------------------------ keys


def organ(hz: float, seconds: float) -> F64:
    """Return a drawbar organ with a turning loudspeaker and a key click."""
    length = seconds + 0.03
    times = seconds_axis(length)
    turning = 2.0 * np.pi * 6.4 * times
    moving = hz * (1.0 + 0.0022 * np.sin(turning))
    drawbars = (
        (0.5, 0.7),
        (1.0, 1.0),
        (1.5, 0.45),
        (2.0, 0.7),
        (3.0, 0.4),
        (4.0, 0.35),
        (6.0, 0.2),
    )
    tone = sum(level * sine(ratio * moving, length, 0.13 * ratio) for ratio, level in drawbars)
    tone = tone * (1.0 + 0.16 * np.sin(turning + 0.8))
    click = highpass(noise(0.006, 7), 1_500.0) * np.hanning(count(0.006))
    tone[: len(click)] += 0.25 * click
    return 0.3 * drive(tone, 0.7) * adsr(length, 0.006, release_s=0.03)


def piano(hz: float, seconds: float) -> F64:
    """Return a bright upright piano: stretched partials, each with its own fall, and a hammer."""
    length = seconds + 0.12
    times = seconds_axis(length)
    tone = np.zeros_like(times)
    for number in range(1, 13):
        partial_hz = number * hz * np.sqrt(1.0 + 0.0004 * number * number)
        if partial_hz > 14_000.0:
            break
        level = number**-0.85 * (0.55 + 0.45 * np.cos(0.9 * number))
        decay_s = 1.5 * (220.0 / hz) ** 0.4 / (1.0 + 0.35 * number)
        tone += (
            level
            * np.sin(2.0 * np.pi * partial_hz * times + 0.7 * number)
            * np.exp(-times / decay_s)
        )
    hammer = bandpass(noise(0.03, 11), 900.0, 5_000.0) * fall(0.03, 0.006)
    tone[: len(hammer)] += 0.35 * hammer
    return 0.5 * tone * adsr(length, 0.002, release_s=0.12)


def bell(hz: float, seconds: float) -> F64:
    """Return a glassy bell (frequency modulation)."""
    length = max(seconds, 0.9)
    times = seconds_axis(length)
    modulator = np.sin(2.0 * np.pi * 3.5 * hz * times) * 2.2 * np.exp(-times / 0.25)
    tone = np.sin(2.0 * np.pi * hz * times + modulator)
    tone += 0.4 * np.sin(2.0 * np.pi * 2.0 * hz * times) * np.exp(-times / 0.4)
    return 0.4 * tone * fall(length, 0.45, 0.002)


def church_bell(hz: float, seconds: float) -> F64:
    """Return a large bell: hum, prime, minor third, fifth, nominal and above."""
    length = max(seconds, 3.5)
    times = seconds_axis(length)
    partials = ((0.5, 0.7, 1.4), (1.0, 1.0, 1.0), (1.183, 0.8, 0.8), (1.506, 0.5, 0.6))
    partials += ((2.0, 0.9, 0.6), (2.514, 0.4, 0.4), (3.01, 0.35, 0.3), (4.17, 0.3, 0.2))
    tone = np.zeros_like(times)
    for ratio, level, decay_s in partials:
        tone += level * np.sin(2.0 * np.pi * ratio * hz * times + ratio) * np.exp(-times / decay_s)
    return 0.3 * tone * adsr(length, 0.003, release_s=0.4)


# ------------------------------------------------------------------ strings


def _string(
    hz: float,
    seconds: float,
    brightness: float,
    damping: float,
    pick: float,
    dullness: float = 0.5,
) -> F64:
    """Return a plucked string (Karplus-Strong, fractional delay).

    Args:
        hz: Pitch.
        seconds: Length.
        brightness: 0..1 of the pluck.
        damping: Loss per round, 0.99 short to 0.9995 long.
        pick: Where it is plucked, as a share of the string: a comb in the spectrum.
        dullness: 0..0.5, how much faster treble dies.
    """
    period = RATE_HZ / hz - dullness
    whole = int(period)
    part = period - whole
    burst = np.random.default_rng(round(10.0 * hz)).uniform(-1.0, 1.0, whole)
    burst = lfilter([brightness], [1.0, brightness - 1.0], burst)
    burst -= np.roll(burst, max(1, round(pick * whole)))
    excitation = np.zeros(count(seconds))
    excitation[: min(whole, len(excitation))] = burst[: len(excitation)]
    feedback = np.zeros(whole + 3)
    feedback[0] = 1.0
    taps = np.convolve([1.0 - part, part], [1.0 - dullness, dullness])
    feedback[whole : whole + 3] -= damping * taps
    return np.asarray(lfilter([1.0], feedback, excitation))


def surf_guitar(hz: float, seconds: float) -> F64:
    """Return a bright electric guitar, picked near the bridge."""
    length = seconds + 0.05
    tone = _string(hz, length, 0.85, 0.994, 0.13, 0.15)
    tone = peak(highpass(tone, 120.0), 2_400.0, 1.2, 1.2)
    return 0.8 * drive(tone, 1.4) * adsr(length, 0.001, release_s=0.05)


def muted_guitar(hz: float, seconds: float) -> F64:
    """Return a funky, damped guitar."""
    length = min(seconds + 0.03, 0.3)
    tone = peak(_string(hz, length, 0.9, 0.972, 0.2), 1_500.0, 1.0, 1.5)
    return 0.9 * highpass(tone, 200.0) * adsr(length, 0.001, release_s=0.04)


def electric_bass(hz: float, seconds: float) -> F64:
    """Return a fingered electric bass."""
    length = seconds + 0.03
    tone = lowpass(_string(hz, length, 0.35, 0.9965, 0.22), 2_600.0)
    return 1.0 * drive(tone, 1.2) * adsr(length, 0.003, release_s=0.03) + 0.35 * sine(
        hz, length
    ) * adsr(length, 0.006, 0.5, 0.5, 0.03)


def slap_bass(hz: float, seconds: float) -> F64:
    """Return a slapped bass: the string hits the frets."""
    length = seconds + 0.02
    tone = _string(hz, length, 0.8, 0.995, 0.09)
    tone = drive(lowpass(tone, 4_200.0), 2.2)
    slap = bandpass(noise(0.02, 5), 1_800.0, 5_000.0) * fall(0.02, 0.004)
    tone[: len(slap)] += 0.3 * slap[: len(tone)]
    return 0.9 * tone * adsr(length, 0.001, release_s=0.02) + 0.4 * sine(hz, length) * adsr(
        length, 0.004, 0.4, 0.6, 0.02
    )


def upright_bass(hz: float, seconds: float) -> F64:
    """Return a round acoustic bass."""
    length = seconds + 0.06
    tone = lowpass(_string(hz, length, 0.18, 0.9955, 0.3), 1_400.0)
    thump = lowpass(noise(0.05, 3), 500.0) * fall(0.05, 0.012)
    tone[: len(thump)] += 0.5 * thump[: len(tone)]
    return 1.3 * tone * adsr(length, 0.004, release_s=0.06) + 0.5 * sine(hz, length) * adsr(
        length, 0.008, 0.35, 0.3, 0.06
    )


# ------------------------------------------------------------------ wind and voices


def brass(hz: float, seconds: float) -> F64:
    """Return a brass section: three players, brighter when the tone speaks, late vibrato."""
    length = seconds + 0.05
    times = seconds_axis(length)
    swell = np.clip(times / 0.045, 0.0, 1.0) * (0.65 + 0.35 * np.exp(-times / 0.18))
    tone = chorus_of_saws(hz, length, 3, 7.0)
    tone = _opening(lowpass(tone, 6_500.0), 1.2 * hz + 250.0, swell)
    wobble = 1.0 + 0.05 * np.clip((times - 0.3) / 0.3, 0.0, 1.0) * np.sin(2.0 * np.pi * 5.2 * times)
    return 0.5 * peak(tone, 1_350.0, 0.5, 1.5) * wobble * adsr(length, 0.02, release_s=0.05)


def flute(hz: float, seconds: float) -> F64:
    """Return a flute with breath and vibrato."""
    length = seconds + 0.06
    times = seconds_axis(length)
    vibrato = np.clip((times - 0.12) / 0.2, 0.0, 1.0) * np.sin(2.0 * np.pi * 5.3 * times)
    moving = hz * (1.0 + 0.005 * vibrato)
    tone = (
        sine(moving, length) + 0.35 * sine(2.0 * moving, length) + 0.12 * sine(3.0 * moving, length)
    )
    breath = bandpass(noise(length, 17), 0.9 * hz, min(5.0 * hz, 15_000.0))
    tone = tone * (1.0 + 0.12 * vibrato) + 0.10 * breath
    return 0.5 * tone * adsr(length, 0.035, 0.2, 0.9, 0.06)


def choir(hz: float, seconds: float) -> F64:
    """Return voices singing "ah": many saws through the vowel's formants."""
    length = seconds + 0.4
    times = seconds_axis(length)
    source = chorus_of_saws(hz, length, 6, 16.0)
    source *= 1.0 + 0.08 * np.sin(2.0 * np.pi * 5.0 * times + 0.01 * hz)
    tone = 0.25 * lowpass(source, 700.0)
    for formant_hz, level, width_hz in (
        (730.0, 1.0, 110.0),
        (1_090.0, 0.6, 120.0),
        (2_440.0, 0.3, 200.0),
    ):
        tone += level * bandpass(source, formant_hz - width_hz, formant_hz + width_hz, order=1)
    breath = bandpass(noise(length, 23), 2_000.0, 6_000.0)
    return 0.5 * (tone + 0.02 * breath) * adsr(length, 0.14, release_s=0.4)
