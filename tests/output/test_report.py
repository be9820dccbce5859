"""report.html: one file that needs nothing else, of one run and of several."""

import base64
import json
import re
from html.parser import HTMLParser

import pytest

from isphcli.output.report import ReportError, answer_lines, question, read_run, report_page, write_report

PNG = b"\x89PNG\r\n\x1a\nnot much of a picture"


def leave(folder, spacing=1e-6, k=1.5e-12, **more):
    folder.mkdir()
    summary = {"title": "Rock <1>", "status": "finished", "permeability": k, "permeability_error": 2e-14,
               "warnings": ["throats & pores are narrow"], "porosity": 0.25, "threads": 2,
               "wall_seconds": {"krylov": 1.0, "total": 2.0}, "peak_memory_bytes": 2**30, "versions": {"numpy": "2.0"},
               **more}
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "case.yaml").write_text(
        f"geometry: {{box: [1, 1]}}\nparticles: {{spacing: {spacing}}}\nfluids: {{water: {{viscosity: 1}}}}\n"
        f"flow: stokes\ndrive: {{axes: [x]}}\noutput: {{directory: {folder}}}\n")
    (folder / "slice.png").write_bytes(PNG)
    return folder


class Page(HTMLParser):
    """Text of a page, tags that were not closed, and what it would fetch."""

    def __init__(self, text):
        super().__init__()
        self.open, self.fetched, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.fetched += [v for k, v in attributes if k in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_a_page_of_one_run_holds_all_and_fetches_nothing(tmp_path):
    write_report(tmp_path / "report.html", [leave(tmp_path / "run")])
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == [] and "http" not in text
    (picture,) = page.fetched
    assert base64.b64decode(picture.removeprefix("data:image/png;base64,")) == PNG
    words = " ".join(page.words)
    for wanted in ("Rock <1>", "What is the permeability along x?", "1.50e-12 m2 = 1520 mD", "2.0e-14 m2",
                   "throats & pores are narrow", "25 %", "2.00 s", "1.00 GB", "numpy 2.0", "{spacing: 1e-06}"):
        assert wanted in words, wanted


def test_runs_side_by_side_say_what_differs(tmp_path):
    runs = [leave(tmp_path / "coarse"), leave(tmp_path / "fine", 5e-7, 1.25e-12, warnings=[])]
    text = report_page([read_run(run) for run in runs])
    assert Page(text).open == [] and Page(text).fetched.count(Page(text).fetched[0]) == 2
    rows = {name: re.findall("<td>(.*?)</td>", rest) for name, rest in re.findall("<tr><th>(.*?)</th>(.*?)</tr>", text)}
    assert rows["particles.spacing"] == ["1e-06", "5e-07"]
    assert rows["permeability"] == ["1.50e-12 m2 = 1520 mD", "1.25e-12 m2 = 1270 mD"]
    assert rows["warnings"] == ["throats &amp; pores are narrow", "none"]
    assert rows["status"] == ["finished"] and text.index("Alike in all") > text.index("What came out")
    assert "output.directory" not in rows and "drive.axes" not in rows


def test_rows_of_three_runs_are_in_the_order_of_one(tmp_path):
    """The second run alone has a range: it stands under the permeability, not behind the folder."""
    runs = [leave(tmp_path / "a"), leave(tmp_path / "b", permeability_range=[1e-12, 2e-12]),
            leave(tmp_path / "c", 5e-7, 1.4e-12)]
    lines = [[name for name, _ in answer_lines(read_run(run))] for run in runs]
    extra = next(name for name in lines[1] if name not in lines[0])
    text = report_page([read_run(run) for run in runs])
    where = [text.index(f"<th>{name.strip()}</th>") for name in ("permeability", extra, "folder")]
    assert where == sorted(where)


def test_questions_of_moving_particles(tmp_path):
    run = read_run(leave(tmp_path / "run"))
    for fluids, drive, words in (({"water": {}, "oil": {}}, {}, "How water and oil move in time"),
                                 ({"water": {}}, {"body_force": [1, 0]}, "How water is driven in time")):
        case = {"fluids": fluids, "flow": "navier_stokes", "drive": drive}
        assert question(type(run)(run.directory, run.summary, case, "", ())).startswith(words)


def test_an_injection_says_all_that_the_terminal_says_with_units(tmp_path):
    folder = leave(tmp_path / "run", k=None, mean_velocity=[1e-3, 0.0], pressure_drop=345.6,
                   two_fluids={"saturation_water": 0.75, "trapped_water": 0.125, "closed_pockets": 0.0625,
                               "capillary_pressure": 1234.5, "pressure_jump": -16.0, "contact_angle": 60.5,
                               "spurious_capillary_number": 1e-4},
                   errors={"main": "volume", "volume": 0.01, "spurious_capillary_number": 1e-4})
    found = [f"{name.strip()}: {value}" for name, value in answer_lines(read_run(folder))]
    for wanted in ("mean pore velocity: x 0.001, y 0 m/s", "pressure drop: 345.6 Pa over the box, of the last step",
                   "saturation water: 0.75", "trapped water: 0.125 of the fluid in the sample",
                   "closed pockets: 0.0625 of the fluid in the sample: no flow passes through them",
                   "capillary pressure: 1234 Pa between the fluids of inlet and outlet, what viscous flow "
                   "takes included",
                   "pressure jump: -16 Pa at the interface, water",
                   "contact angle: 60.5 degrees through water",
                   "error volume: +1 %", "error spurious_capillary_number: 0.0001"):
        assert wanted in found, wanted


def test_velocities_of_an_image_are_those_of_the_sample(tmp_path):
    run = read_run(leave(tmp_path / "run", k=None, mean_velocity=[1e-3, 0.0]))
    image = type(run)(run.directory, run.summary, {**run.case, "geometry": {"voxels": {"file": "rock.npy"}}}, "", ())
    assert dict(answer_lines(run))["mean pore velocity"] == "x 0.001, y 0 m/s"
    assert dict(answer_lines(image))["mean pore velocity"] == "x 0.001, y 0 m/s in the sample"


def test_folders_that_are_none_of_a_run(tmp_path):
    with pytest.raises(ReportError, match=r"has no summary\.json"):
        read_run(tmp_path)
    broken = leave(tmp_path / "run")
    (broken / "summary.json").write_text("{")
    with pytest.raises(ReportError, match="cannot be read"):
        write_report(tmp_path / "report.html", [broken])
    assert not (tmp_path / "report.html").exists()
