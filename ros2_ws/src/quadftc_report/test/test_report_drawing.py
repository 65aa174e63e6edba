"""Both renderers: what is drawn is what is described, and nothing is hidden, clipped or overlapping."""

import dataclasses
import itertools
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from quadftc_report.decimation import LIMIT
from quadftc_report.description import Band, Envelope, Figure, Mark, Panel, Shade, Trace
from quadftc_report.draw_matplotlib import STYLE, WIDTH, draw, save_figure
from quadftc_report.draw_plotly import plotly_figure, spec_of
from quadftc_report.style import line_style

TIME = np.arange(20_000) / 250.0
SPIKE = 12_345  # sample with the largest value of the noisy line
GAP = slice(6_000, 6_500)


def noisy() -> np.ndarray:
    y = np.random.default_rng(0).normal(size=len(TIME))
    y[SPIKE] = 9.0
    y[GAP] = np.nan
    return y


def single(**changes) -> Figure:
    """A figure of one axis with everything in it."""
    smooth = np.sin(TIME)
    lines = (
        Trace("reference", "reference", TIME, smooth),
        Trace("proposed", "proposed", TIME, smooth + 0.1),
        Trace("conventional", "compared", TIME, noisy(), rank=0),
    )
    upper = Panel(
        title="roll",
        y_label="roll angle",
        unit="deg",
        traces=lines,
        shades=(Shade(20.0, 40.0, "fault window"), Shade(50.0, 70.0, "fault window")),
        marks=(Mark(5.0, "disturbance onset"),),
        envelopes=(Envelope("estimate ±2σ", "proposed", TIME, smooth - 1.0, smooth + 1.0),),
        height=1.5,
    )
    lower = Panel(title="error", y_label="error", unit="deg", traces=lines[1:])
    figure = Figure(
        "small-tracking-roll", "Roll tracking", "What one sees: 1 deg.", (upper, lower), (0.0, 80.0)
    )
    return dataclasses.replace(figure, **changes)


def triple() -> Figure:
    """A figure of three axes with long labels and several runs."""
    labels = ("proposed", "conventional", "another_rather_long_name", "cascade")
    panels = tuple(
        Panel(
            title=axis,
            y_label=f"{axis} torque",
            unit="N m",
            traces=tuple(
                Trace(label, "compared" if rank else "proposed", TIME, np.cos(TIME + rank), max(rank - 1, 0))
                for rank, label in enumerate(labels)
            ),
            shades=(Shade(20.0, 40.0, "fault window"), Shade(60.0, 65.0, "gyro bias", 1)),
            bands=(Band(-1.2, 1.2, "limits of the rotors", "limit"),),
        )
        for axis in ("roll", "pitch", "yaw")
    )
    return Figure("small-torque", "Torque command", "Torque of each axis.", panels, (0.0, 80.0))


FIGURES = {"single": single, "triple": triple}


def traces_of(drawing, name: str, axis: str = "y"):
    return next(trace for trace in drawing.data if (trace.name, trace.yaxis) == (name, axis))


def test_compared_runs_never_look_alike():
    looks = [line_style("proposed"), line_style("reference"), *(line_style("compared", n) for n in range(20))]
    assert len({(look.colour, look.dashes) for look in looks}) == len(looks)


def test_role_without_a_look_is_refused():
    with pytest.raises(ValueError, match="role = 'estimate': expected truth, reference"):
        line_style("estimate")


@pytest.fixture(scope="module")
def printed(tmp_path_factory) -> list[Path]:
    return save_figure(single(), tmp_path_factory.mktemp("printed") / "figures")


def test_print_is_one_column_wide_and_named_by_its_key(printed):
    png, pdf = printed
    assert [png.name, pdf.name] == ["small-tracking-roll.png", "small-tracking-roll.pdf"]
    with Image.open(png) as image:
        assert image.size[0] == round(300 * WIDTH)
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.01)
        assert image.text["Title"] == single().title


def test_print_is_the_same_bytes_whatever_the_settings_of_the_caller(printed, tmp_path):
    with mpl.rc_context({"font.size": 20.0, "lines.linewidth": 5.0}):
        again = save_figure(single(), tmp_path)
        assert mpl.rcParams["font.size"] == 20.0
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in printed]


def test_pdf_carries_truetype_text_and_its_caption(printed):
    content = printed[1].read_bytes()
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    assert b"CreationDate" not in content
    assert b"What one sees: 1 deg." in content


@pytest.fixture
def print_style():
    with mpl.rc_context({**mpl.rcParamsDefault, **STYLE}):
        yield


@pytest.mark.usefixtures("print_style")
@pytest.mark.parametrize("figure", FIGURES)
def test_nothing_of_the_print_is_clipped_and_no_text_overlaps(figure):
    canvas = draw(FIGURES[figure]())
    canvas.draw_without_rendering()
    page = canvas.bbox
    (legend,) = canvas.legends
    boxes = [ax.yaxis.label.get_window_extent() for ax in canvas.axes]
    boxes += [legend.get_window_extent(), canvas.axes[-1].xaxis.label.get_window_extent()]
    panels = [ax.get_window_extent() for ax in canvas.axes]
    for box in [*boxes, *(ax.get_tightbbox() for ax in canvas.axes)]:
        assert page.x0 <= box.x0 < box.x1 <= page.x1
        assert page.y0 <= box.y0 < box.y1 <= page.y1
    for one, other in itertools.combinations([*boxes, *panels], 2):
        assert not one.overlaps(other)
    assert len({panel.x0 for panel in panels}) == 1
    assert all(panel.height > 0.6 * canvas.dpi for panel in panels)


WORDS = ("starting", "healthy", "suspect", "faulty")


def worded() -> Figure:
    """A figure of a state, on a scale of words."""
    state = np.where(TIME < 40.0, 1.0, 3.0)
    panel = Panel(
        title="roll",
        y_label="roll",
        unit="",
        traces=(Trace("proposed", "proposed", TIME, state),),
        ticks=tuple(enumerate(WORDS)),
    )
    return single(panels=(panel,))


@pytest.mark.usefixtures("print_style")
def test_print_has_words_for_ticks_where_they_are_given():
    (ax,) = draw(worded()).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == list(WORDS)
    assert (ax.get_yticks().tolist(), ax.get_ylabel()) == ([0.0, 1.0, 2.0, 3.0], "roll")
    low, high = ax.get_ylim()
    assert low < 0.0 < 3.0 < high


def test_screen_has_words_for_ticks_and_values():
    drawing = plotly_figure(worded())
    assert drawing.layout.yaxis.ticktext == WORDS
    assert drawing.layout.yaxis.title.text == "roll"
    (trace,) = drawing.data
    assert trace.hovertemplate == "roll, proposed: %{text}<extra></extra>"
    assert set(zip(trace.y.tolist(), trace.text, strict=True)) == {(1.0, "healthy"), (3.0, "faulty")}


@pytest.mark.usefixtures("print_style")
def test_print_shows_extremes_and_gaps():
    line = next(line for line in draw(single()).axes[0].lines if np.nanmax(line.get_ydata()) == 9.0)
    t, y = line.get_data()
    assert t[np.nanargmax(y)] == TIME[SPIKE]
    assert len(y) <= LIMIT
    assert np.sum(np.isnan(y)) == 1


@pytest.mark.parametrize("figure", FIGURES)
def test_screen_shows_every_line_on_one_time_axis(figure):
    described = FIGURES[figure]()
    drawing = plotly_figure(described)
    assert {trace.xaxis or "x" for trace in drawing.data} == {"x"}
    for number, panel in enumerate(described.panels, 1):
        axis = "y" if number == 1 else f"y{number}"
        names = [trace.name for trace in drawing.data if trace.yaxis == axis]
        assert names == [item.name for item in (*panel.traces, *panel.envelopes)] + [
            b.label for b in panel.bands
        ]
        assert drawing.layout[f"yaxis{axis[1:]}"].title.text == f"{panel.y_label} [{panel.unit}]"
    domains = [
        drawing.layout[f"yaxis{n if n > 1 else ''}"].domain for n in range(1, len(described.panels) + 1)
    ]
    assert domains[0][1] == 1.0
    assert domains[-1][0] == 0.0
    assert all(upper[0] > lower[1] for upper, lower in itertools.pairwise(domains))


def test_screen_shows_extremes_and_gaps():
    trace = traces_of(plotly_figure(single()), "conventional")
    assert trace.x[np.nanargmax(trace.y)] == np.float32(TIME[SPIKE])
    assert len(trace.y) <= LIMIT
    assert np.sum(np.isnan(trace.y)) == 1
    assert not trace.connectgaps


def test_screen_names_each_run_once_in_the_legend():
    drawing = plotly_figure(triple())
    shown = [item.name for item in (*drawing.data, *drawing.layout.shapes) if item.showlegend]
    assert len(shown) == len(set(shown)) == 7
    assert all(item.legendgroup == item.name for item in (*drawing.data, *drawing.layout.shapes))


def test_screen_gives_values_with_their_unit():
    trace = traces_of(plotly_figure(single()), "proposed")
    assert trace.hovertemplate == "roll, proposed: %{y:.4~g} deg<extra></extra>"


def test_screen_shades_windows_and_marks_onsets_in_their_panel():
    upper = [shape for shape in plotly_figure(single()).layout.shapes if shape.yref == "y domain"]
    assert [(shape.x0, shape.x1) for shape in upper] == [(20.0, 40.0), (50.0, 70.0), (5.0, 5.0)]
    assert not [shape for shape in plotly_figure(single()).layout.shapes if shape.yref == "y2 domain"]


def test_screen_area_is_closed_around_each_stretch():
    low, high = np.where((TIME > 30.0) & (TIME < 40.0), np.nan, [[-1.0], [1.0]])
    panel = dataclasses.replace(
        single().panels[0], envelopes=(Envelope("estimate ±2σ", "proposed", TIME, low, high),)
    )
    area = traces_of(plotly_figure(single(panels=(panel,))), "estimate ±2σ")
    ends = np.flatnonzero(np.isnan(area.x))
    assert len(ends) == 2
    for outline in np.split(area.x, ends + 1)[:2]:
        assert outline[0] == outline[-2]  # forth and back again
        assert not np.any((outline > 30.0) & (outline < 40.0))


def test_page_gets_numbers_that_json_allows_and_not_too_many():
    text = plotly_figure(single()).to_json()

    def refuse(constant: str):
        raise AssertionError(f"{constant} in the JSON")

    assert json.loads(text, parse_constant=refuse)["data"]
    assert len(text) < 200_000  # 100 000 samples, two of them in a line of noise


def test_config_saves_under_the_key_and_sends_nothing_away():
    config = spec_of(plotly_figure(single()), "small-tracking-roll")["config"]
    assert config["toImageButtonOptions"]["filename"] == "small-tracking-roll"
    assert not config["displaylogo"]
    assert {"toImage", "resetScale2d"} <= set(config["modeBarButtons"][0])
