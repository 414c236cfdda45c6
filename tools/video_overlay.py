"""The caption of the video: track, asked, danced, time, and the show as a strip of colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from downbeat.tools import palette
from downbeat.tools.truth import Truth

BAR_HEIGHT = 0.135
"""Of the picture's height."""
STRIP_HEIGHT = 0.018
LABEL_SIZE, TEXT_SIZE, CHIP_SIZE = 0.024, 0.034, 0.036


@dataclass(frozen=True)
class Moment:
    """What the caption says.

    Attributes:
        time_s: Of the show.
        track: Name; empty between tracks.
        asked: Skill of the section.
        danced: Skill with the weight.
        incoming: During a blend, the skill that comes; else empty.
        weight: Of the incoming skill, 0..1.
        pulse: 1 on the beat, falling to 0.
        is_fallen: The robot is down.
    """

    time_s: float
    track: str
    asked: str
    danced: str
    incoming: str
    weight: float
    pulse: float
    is_fallen: bool


class Overlay:
    """Draws captions into pictures of one size."""

    def __init__(self, size_px: tuple[int, int], truth: Truth, colours: dict[str, str]) -> None:
        self._width, self._height = size_px
        self._truth = truth
        self._colours = colours
        self._fonts: dict[float, ImageFont.FreeTypeFont] = {}
        self._strip = self._draw_strip()
        self._bars: dict[tuple[str, ...], Image.Image] = {}

    def draw(self, picture: Image.Image, moment: Moment) -> None:
        """Draw the caption of a moment into an RGB picture."""
        key = (moment.track, moment.asked, moment.danced, moment.incoming, str(moment.is_fallen))
        bar = self._bars.get(key)
        if bar is None:
            bar = self._bars[key] = self._draw_bar(moment)
        top = self._height - bar.height
        picture.paste(bar, (0, top), bar)
        draw = ImageDraw.Draw(picture)
        self._draw_beat(draw, moment, top)
        self._draw_time(draw, moment, top)
        strip_top = self._height - self._strip.height
        picture.paste(self._strip, (0, strip_top))
        head = self._x(moment.time_s)
        draw.rectangle((head - 1, strip_top - 3, head + 1, self._height), fill=palette.INK)

    def _font(self, size: float) -> ImageFont.FreeTypeFont:
        if size not in self._fonts:
            from matplotlib import get_data_path

            path = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf"
            self._fonts[size] = ImageFont.truetype(str(path), max(9, round(size * self._height)))
        return self._fonts[size]

    def _x(self, time_s: float) -> float:
        return min(max(time_s / self._truth.duration_s, 0.0), 1.0) * self._width

    def _draw_strip(self) -> Image.Image:
        height = max(4, round(STRIP_HEIGHT * self._height))
        strip = Image.new("RGB", (self._width, height), palette.rgb(palette.PANEL))
        draw = ImageDraw.Draw(strip)
        for section in self._truth.sections:
            box = (self._x(section.start_s) + 1, 0, self._x(section.end_s) - 1, height)
            draw.rectangle(box, fill=palette.rgb(self._colours[section.skill]))
        return strip

    def _draw_bar(self, moment: Moment) -> Image.Image:
        """Draw what changes only with the section: a dark ramp, the words, the chips."""
        height = round((BAR_HEIGHT + STRIP_HEIGHT) * self._height)
        bar = Image.new("RGBA", (self._width, height))
        ramp = Image.linear_gradient("L").resize((self._width, height))
        bar.putalpha(ramp.point(lambda v: min(225, int(v * 1.6))))
        draw = ImageDraw.Draw(bar)
        label_y, text_y = 0.30 * height, 0.60 * height
        columns = (0.062, 0.42, 0.62)
        for x, label in zip(columns, ("TRACK", "ASKED", "DANCED")):
            draw.text(
                (x * self._width, label_y),
                label,
                font=self._font(LABEL_SIZE),
                fill=(*palette.rgb(palette.MUTED), 255),
                anchor="lm",
            )
        track = moment.track.replace("_", " ") or "silence"
        track = track if len(track) <= 24 else track[:23] + "\u2026"
        draw.text(
            (columns[0] * self._width, text_y),
            track,
            font=self._font(TEXT_SIZE),
            fill=(*palette.rgb(palette.INK), 255),
            anchor="lm",
        )
        right = self._draw_chip(draw, columns[1] * self._width, text_y, moment.asked)
        right = self._draw_chip(draw, columns[2] * self._width, text_y, moment.danced)
        if moment.is_fallen:
            self._draw_chip(draw, right + 8, text_y, "fallen", palette.BAD)
        elif moment.incoming and moment.incoming != moment.danced:
            self._draw_chip(draw, right + 8, text_y, moment.incoming)
        return bar

    def _draw_chip(
        self, draw: ImageDraw.ImageDraw, x: float, y: float, text: str, colour: str = ""
    ) -> float:
        """Draw a coloured pill with a word in it; return where it ends."""
        if not text:
            return x
        font = self._font(CHIP_SIZE)
        pad = 0.016 * self._height
        half = 0.028 * self._height
        width = draw.textlength(text, font=font)
        fill = palette.rgb(colour or self._colours.get(text, palette.STAND_COLOUR))
        box = (x, y - half, x + width + 2 * pad, y + half)
        draw.rounded_rectangle(box, radius=half * 0.55, fill=(*fill, 255))
        is_dark = text in palette.STANDING
        ink = palette.rgb(palette.INK if is_dark else palette.BACKGROUND)
        draw.text((x + pad, y), text, font=font, fill=(*ink, 255), anchor="lm")
        return box[2]

    def _draw_beat(self, draw: ImageDraw.ImageDraw, moment: Moment, top: int) -> None:
        """Draw a dot that jumps on the beat and shrinks until the next."""
        bar_height = self._height - top
        x, y = 0.034 * self._width, top + 0.60 * bar_height
        radius = self._height * (0.007 + 0.011 * moment.pulse)
        colour = palette.rgb(self._colours.get(moment.danced, palette.STAND_COLOUR))
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)

    def _draw_time(self, draw: ImageDraw.ImageDraw, moment: Moment, top: int) -> None:
        bar_height = self._height - top
        shown = min(max(moment.time_s, 0.0), self._truth.duration_s)
        text = f"{_clock(shown)} / {_clock(self._truth.duration_s)}"
        draw.text(
            (0.972 * self._width, top + 0.60 * bar_height),
            text,
            font=self._font(TEXT_SIZE),
            fill=palette.rgb(palette.INK),
            anchor="rm",
        )


def _clock(time_s: float) -> str:
    return f"{int(time_s) // 60}:{int(time_s) % 60:02d}"
