# pyright: basic
"""Strip charts of the last 30 s; rows of `Picture` go to the browser as they come, and are drawn there."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from quadftc_cli.live_page.picture import Picture
from quadftc_cli.live_page.scene import CORRECTED, MEASURED, TRUTH

WINDOW = 30.0  # s
FONT = "Roboto, sans-serif"
REFERENCE, BAND, INJECTED = "#9aa0a8", "rgba(0, 114, 178, 0.18)", "#d55e00"
ROTORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000", "#999999")
# first columns of three, by what is in them: those of `Picture._row`
REFERENCE_AT, TRUTH_AT, MEASURED_AT, CORRECTED_AT = 1, 4, 7, 10
RATE_AT, GYRO_AT, CORRECTED_RATE_AT = 13, 16, 19
INJECTED_AT, ESTIMATE_AT, LOW_AT, BAND_AT, TORQUE_AT = 22, 25, 28, 31, 34
PLACE_REFERENCE_AT, PLACE_AT, ROTORS_AT = 37, 40, 43  # where the plant has a position
TOP_VIEW = "top view: x right, y up"
WITHOUT_ENDS = {"showMinLabel": False, "showMaxLabel": False}  # where an axis ends between two round numbers

Options = dict[str, object]  # of an axis, as ECharts takes them
Line = tuple[str, str, int, bool]  # name, colour, column, by axis
Chart = tuple[str, str, list[Line], Options]

OF_ATTITUDE: list[Line] = [
    ("reference", REFERENCE, REFERENCE_AT, True),
    ("measured", MEASURED, MEASURED_AT, True),
    ("truth", TRUTH, TRUTH_AT, True),
    ("corrected", CORRECTED, CORRECTED_AT, True),
]
OF_FAULT: list[Line] = [
    ("low", "transparent", LOW_AT, True),
    ("±2σ", BAND, BAND_AT, True),
    ("injected", INJECTED, INJECTED_AT, True),
    ("estimate", CORRECTED, ESTIMATE_AT, True),
]
OF_RATE: list[Line] = [
    ("gyro", MEASURED, GYRO_AT, True),
    ("truth", TRUTH, RATE_AT, True),
    ("corrected", CORRECTED, CORRECTED_RATE_AT, True),
]
SMALL = {"fontSize": 11, "color": "#5b626c"}
HEADING = {"fontSize": 13, "fontWeight": 500, "color": "#2a2e34", "fontFamily": FONT}
KEY = {"itemWidth": 14, "itemHeight": 8, "icon": "roundRect"}
AXIS: Options = {
    "type": "value",
    "axisTick": {"show": False},
    "splitLine": {"lineStyle": {"color": "#eef0f3"}},
}
TIME: Options = {
    "min": -WINDOW,
    "max": 0,
    "interval": 10,
    "axisLabel": {**SMALL, "formatter": "{value} s"},
    "axisLine": {"onZero": False, "lineStyle": {"color": "#c9ced6"}},
}
VALUE: Options = {"scale": True, "splitNumber": 3, "axisLine": {"show": False}, "axisLabel": SMALL}
# a narrow chart has its legend below the title
NARROW = {"legend": {"left": 4, "top": 22, "right": None}, "grid": {"top": 48}}


class StripCharts(ui.element, component="charts.js"):
    """Charts of an axis that can be chosen; draws them some 10 times a second."""

    def __init__(self, picture: Picture) -> None:
        super().__init__()
        self._picture = picture
        self._sent = 0
        with ui.element("div").classes("charts"):
            charts = [_chart(*each) for each in _plan(picture)]
        self._props["charts"] = [{"id": chart.id, "columns": columns} for chart, columns in charts]
        self._props["window"] = WINDOW
        self._props["map"] = charts[-1][0].id if picture.rotors else None

    def push(self) -> None:
        """Send the rows that have come since the last time."""
        new = min(self._picture.count - self._sent, len(self._picture.rows))
        self._sent = self._picture.count
        if new:
            rows = list(self._picture.rows)[-new:]
            self.run_method("push", [[_short(value) for value in row] for row in rows])

    def choose(self, axis: int) -> None:
        """Show another axis."""
        self.run_method("choose", axis)


def _short(value: float) -> float | None:
    return round(value, 4) if value == value else None  # NaN is none


def _plan(picture: Picture) -> list[Chart]:
    """Return title, unit, lines and options of the y axis of each chart that will not stay empty."""
    plan: list[Chart] = [("attitude", "deg", OF_ATTITUDE, {})]
    if not {"fault/status", "fault/injected"} <= picture.silent:
        plan.append(("attitude fault", "deg", OF_FAULT, {}))
    plan.append(("body rate", "deg/s", OF_RATE, {}))
    if not picture.rotors:
        return [*plan, ("torque command", "N m", [("torque", CORRECTED, TORQUE_AT, True)], {})]
    if "rotors/status" not in picture.silent:
        lines = [(f"{k + 1}", ROTORS[k % len(ROTORS)], ROTORS_AT + k, False) for k in range(picture.rotors)]
        plan.append(("rotor effectiveness", "%", lines, {"min": 0, "max": 120, "interval": 40}))
    place = [("reference", REFERENCE, PLACE_REFERENCE_AT), ("vehicle", TRUTH, PLACE_AT)]
    plan.append(("position", "m", [(*line, True) for line in place], {}))
    # last, as `charts.js` draws it against another axis
    return [*plan, (TOP_VIEW, "m", [(*line, False) for line in place], {})]


def _series(name: str, colour: str) -> dict[str, Any]:
    """A line without data."""
    style: dict[str, object] = {"width": 3.0 if name in ("truth", "injected") else 1.4, "color": colour}
    line = {"name": name, "type": "line", "showSymbol": False, "silent": True, "color": colour, "data": []}
    if name in ("low", "±2σ"):  # a band is stacked on its lower end
        area = {"areaStyle": {"color": colour if name == "±2σ" else "transparent"}}
        return line | {"stack": "band", "stackStrategy": "all", "lineStyle": {"width": 0}} | area
    return line | {"lineStyle": style | ({"type": "dashed"} if name == "reference" else {})}


def _chart(title: str, unit: str, lines: list[Line], y_axis: Options) -> tuple[ui.echart, list[list[int]]]:
    """Make a chart; return it with the columns of its lines, and whether they are of the chosen axis."""
    series = [_series(name, colour) for name, colour, _, _ in lines]
    names = [name for name, *_ in lines if name != "low"] if len(lines) > 1 else []
    x_axis, y_axis = {**AXIS, **TIME}, {**AXIS, **VALUE, **y_axis}
    if title == TOP_VIEW:
        x_axis = y_axis = {**AXIS, **VALUE, "axisLabel": {**SMALL, **WITHOUT_ENDS}}
        series[1]["markPoint"] = {"symbol": "circle", "symbolSize": 9, "data": []}
    options = {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "title": {"text": f"{title} [{unit}]", "left": 8, "top": 4, "textStyle": HEADING},
        "legend": {"right": 8, "top": 4, "data": names, "textStyle": SMALL, **KEY},
        "grid": {"left": 46, "right": 16, "top": 30, "bottom": 22},
        "xAxis": x_axis,
        "yAxis": y_axis,
        "series": series,
    }
    options = {"baseOption": options, "media": [{"query": {"maxWidth": 420}, "option": NARROW}]}
    element = ui.echart(options).classes("chart").props(f'data-chart="{title}"')
    return element, [[column, by_axis] for _, _, column, by_axis in lines]
