# pyright: basic
"""The page: a place to drop logs on, and the list of what became of them."""

from __future__ import annotations

from collections.abc import Callable

from fastapi import FastAPI
from nicegui import ui

from quadftc_replay.inspection.verdict import show
from quadftc_report.serve.jobs import REPORT, VERDICT, Job, Jobs

Ask = Callable[[Job], None]
PERIOD = 0.5  # s; the list is looked at this often
FORMATS = (
    "ROS 1 and ROS 2 bags, PX4 ULog, ArduPilot .BIN and .log, MAVLink .tlog, Betaflight and INAV blackbox,"
    " Crazyflie uSD, tables (CSV); as they are, or in a ZIP, gzip or Zstandard file"
)
COLOURS = {"waiting": "grey", "running": "primary", "failed": "warning"}


def add_page(app: FastAPI, jobs: Jobs) -> None:
    """Add the page to an application."""

    @ui.page("/")
    def page() -> None:
        ui.label("quadftc: what failed in this flight?").classes("text-h5")
        ui.label(f"Drop flight logs here: {FORMATS}. They stay on this machine, in {jobs.folder}.")
        _uploader(jobs)
        _settings(jobs)
        ask = _choice(jobs)

        @ui.refreshable
        def listing() -> None:
            for job in jobs.all():
                _card(jobs, job, ask)
            if not jobs.all():
                ui.label("No log yet.").classes("text-grey")

        listing()
        seen = [jobs.version]

        def look() -> None:
            if seen[0] != jobs.version:
                seen[0] = jobs.version
                listing.refresh()

        ui.timer(PERIOD, look)

    ui.run_with(app, title="quadftc serve", dark=None, tailwind=False, show_welcome_message=False)


def _uploader(jobs: Jobs) -> None:
    """Sends each file as it is, to be written to disk while it comes."""
    upload = ui.upload(multiple=True, auto_upload=True, max_file_size=jobs.largest, label="Flight logs")
    upload.props(
        'url="/logs" send-raw flat bordered style="width: 100%; max-width: 50rem"'
        " :headers=\"files => [{name: 'X-Name', value: encodeURIComponent(files[0].name)}]\""
    )
    largest = f"{jobs.largest >> 20} MiB"
    upload.on_rejected(lambda: ui.notify(f"A log may have at most {largest}.", type="negative"))
    upload.on("failed", lambda: ui.notify("The log could not be stored.", type="negative"), args=[])
    upload.on("uploaded", lambda: upload.run_method("removeUploadedFiles"), args=[])


def _settings(jobs: Jobs) -> None:
    """Ask for faults to put on the logs that come next."""

    def put() -> None:
        try:
            jobs.put_faults(faults.value or "")
        except ValueError as error:
            faults.props["error"], faults.props["error-message"] = True, str(error)
        else:
            faults.props["error"] = False
        faults.update()

    faults = ui.textarea("Faults to put on the next logs, one a line", value="\n".join(jobs.faults))
    faults.props('dense outlined autogrow placeholder="bias channel=gyro axis=roll value=0.3 start=20s"')
    faults.style("width: 100%; max-width: 50rem").on("blur", put)


def _choice(jobs: Jobs) -> Ask:
    """Add a dialog about one log: which of several in the file it is, and what its columns mean."""
    asked: list[Job] = []

    def judge() -> None:
        dialog.close()
        jobs.choose(asked[-1].id, int(number.value or 0), int(system.value or 0), mapping.value or "")

    def ask(job: Job) -> None:
        asked.append(job)
        number.value, system.value = job.log or None, job.system or None
        mapping.value = job.mapping or mapping.value
        dialog.open()

    with ui.dialog() as dialog, ui.card().style("width: 100%; max-width: 50rem"):
        number = ui.number("Log, of several in the file (--log)", min=1, precision=0)
        system = ui.number("Vehicle, by its MAVLink system (--system)", min=1, max=255, precision=0)
        mapping = ui.textarea("What the columns of a table mean (--mapping)").props("outlined autogrow")
        for field in (number, system, mapping):
            field.style("width: 100%")
        ui.button("Judge", on_click=judge)
    return ask


def _card(jobs: Jobs, job: Job, ask: Ask) -> None:
    """Show one log."""
    with ui.card().style("width: 100%; max-width: 50rem").props(f'data-state="{job.state}"'):
        with ui.row().style("width: 100%; align-items: center"):
            ui.label(job.name).classes("text-weight-bold")
            ui.label(f"{job.received:%Y-%m-%d %H:%M} UTC, {job.size / 1e6:.1f} MB").classes("text-grey")
            ui.space()
            _badge(job)
        if job.state == "running":
            ui.linear_progress(job.progress, show_value=False)
        if job.baseline or job.faults:
            against = (
                [f"against {jobs.name_of(job.baseline) or 'a log that was removed'}"] if job.baseline else []
            )
            ui.label("; ".join([*against, *(f"with {spec}" for spec in job.faults)])).classes("text-grey")
        if job.message:
            ui.label(job.message)
        if job.verdict is not None:
            _verdict(jobs, job)
        _buttons(jobs, job, ask)


def _buttons(jobs: Jobs, job: Job, ask: Ask) -> None:
    is_baseline = jobs.baseline == job.id
    actions = {
        "No longer the baseline" if is_baseline else "Baseline of the others": lambda: jobs.mark_baseline(
            "" if is_baseline else job.id
        ),
        "Choose": lambda: ask(job),
        "Judge again": lambda: jobs.judge_again(job.id),
        "Remove": lambda: jobs.remove(job.id),
    }
    with ui.row().style("align-self: end"):
        for label, act in actions.items():
            ui.button(label, on_click=act).props("flat dense size=sm")


def _badge(job: Job) -> None:
    if job.verdict is None:
        ui.badge(job.state, color=COLOURS.get(job.state, "grey"))
    elif job.verdict.outcome != "fault":
        ui.badge(job.verdict.outcome, color="positive" if job.verdict.healthy else "warning")
    else:
        count = len(job.verdict.findings)
        ui.badge(f"{count} finding{'s' if count > 1 else ''}", color="negative")


def _verdict(jobs: Jobs, job: Job) -> None:
    """Show the verdict: its sentence, its findings, and the files."""
    assert job.verdict is not None
    ui.label(job.verdict.sentence)
    rows = [
        {
            "what": f"{each.name}: {each.kind}",
            "onset": f"{each.onset_s:.2f}",
            "size": "" if each.size is None else show(each.size, each.unit),
            "probability": f"{100.0 * each.probability:.0f} %",
            "or": ", ".join(each.ambiguous_with),
        }
        for each in job.verdict.findings
    ]
    if rows:
        heads = {
            "what": "finding",
            "onset": "onset [s]",
            "size": "size",
            "probability": "probability",
            "or": "or",
        }
        columns = [
            {"name": key, "label": label, "field": key, "align": "left"} for key, label in heads.items()
        ]
        ui.table(rows=rows, columns=columns).props("dense flat")
    for each in job.verdict.advice:
        ui.label(f"for the next flight: {each}")
    for each in job.verdict.not_judged:
        ui.label(f"not judged: {each.component}: {each.reason}").classes("text-grey")
    with ui.row():
        for name, label in ((REPORT, "Report"), (VERDICT, VERDICT)):
            if jobs.result(job.id, name):
                ui.link(label, f"/logs/{job.id}/{name}", new_tab=True)
