"""The certificate says what the fit says, is valid against the schema, and invents nothing."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
import xmlschema

import calib
from calib.errors import BadInputError, RefusedError
from calib.radius.result import write_result
from calib.reporting.exports import export_from
from calib.reporting.exports.dcc import certificate_of

SAMPLES = Path(__file__).parents[3] / "sample_runs"
DOCUMENTATION = (Path(__file__).parents[3] / "docs" / "exports.md").read_text(encoding="utf-8")
#: the section of `campaign.toml` as the documentation has it
EXAMPLE = "[certificate]" + DOCUMENTATION.split("```toml\n[certificate]")[1].split("```")[0]
NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
#: digits of an uncertainty in the certificate
WRITTEN = 1e-3


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    folder = tmp_path / "crossed"
    shutil.copytree(SAMPLES / "corridor_crossed", folder)
    settings = folder / "campaign.toml"
    settings.write_text(settings.read_text() + "\n" + EXAMPLE)
    return folder


def _root(path: Path, accept: str = "") -> ElementTree.Element:
    return ElementTree.fromstring(export_from(path, "dcc", accept=accept)[0].data)


def test_valid_against_the_schema(campaign: Path, shared_data: Path) -> None:
    def beside(address: str) -> str:
        """The one schema imports the other by its web address."""
        return str(shared_data / "dcc" / "SI_Format_2_0_0.xsd") if address.endswith("SI_Format.xsd") else address

    schema = xmlschema.XMLSchema(str(shared_data / "dcc" / "dcc_3_0_0.xsd"), uri_mapper=beside)
    text = export_from(campaign, "dcc")[0].data.decode()
    assert [error.reason for error in schema.iter_errors(text)] == []
    # the check can fail: without its identifier the same certificate is not valid
    cut = text.replace("<dcc:uniqueIdentifier>2025-0311</dcc:uniqueIdentifier>", "")
    assert not schema.is_valid(cut)


def test_numbers_are_those_of_the_fit(campaign: Path) -> None:
    fit, root = calib.fit(campaign), _root(campaign)
    results = root.findall(".//dcc:measurementResult", NAMES)
    assert len(results) == 2
    for result, wheel in zip(results, (fit.left, fit.right), strict=True):
        reals = {
            real.findtext("si:label", namespaces=NAMES): real
            for real in result.findall(".//dcc:quantity/si:real", NAMES)
        }
        slope, interval = reals["slope"], wheel.slope_ci95_m_per_N
        assert interval is not None
        assert float(slope.findtext("si:value", "", NAMES)) == pytest.approx(wheel.law.slope_m_per_N, rel=1e-11)
        half = float(slope.findtext("si:expandedUnc/si:uncertainty", "", NAMES))
        assert half == pytest.approx(0.5 * (interval[1] - interval[0]), rel=WRITTEN)
        k = float(slope.findtext("si:expandedUnc/si:coverageFactor", "", NAMES))
        assert half / k == pytest.approx(wheel.law.covariance[1, 1] ** 0.5, rel=WRITTEN)
        assert slope.findtext("si:unit", "", NAMES) == r"\metre\newton\tothe{-1}"
        loads, radii = result.findall(".//si:list/si:realList", NAMES)[:2]
        values = [
            [float(value.text or "") for value in part.findall("si:real/si:value", NAMES)] for part in (loads, radii)
        ]
        assert values[1] == pytest.approx(wheel.law.radius_m(values[0]).tolist(), rel=1e-11)
        assert min(values[0]) >= wheel.law.load_min_N - 1 and max(values[0]) <= wheel.law.load_max_N + 1
        # Student's t times u at each load; at the reference load the U of the coefficient
        halves, factors = (
            [float(value.text or "") for value in radii.findall(f".//si:expandedUnc/si:{name}", NAMES)]
            for name in ("uncertainty", "coverageFactor")
        )
        std = [half / k for half, k in zip(halves, factors, strict=True)]
        assert std == pytest.approx(wheel.law.mean_std_m(values[0]).tolist(), rel=WRITTEN)
        at_reference = reals["radius_at_reference_load"].findtext("si:expandedUnc/si:uncertainty", "", NAMES)
        lowest = values[0].index(min(values[0]))
        assert values[0][lowest] == pytest.approx(wheel.reference_load_N, abs=1.0)
        # the lowest load is within a newton of the reference load
        assert halves[lowest] == pytest.approx(float(at_reference), rel=0.01)
        covariances = [float(value.text or "") for value in result.findall(".//si:covariance/si:value", NAMES)]
        assert covariances == pytest.approx(wheel.law.covariance.ravel().tolist(), rel=1e-11)


def test_what_is_not_stated_is_refused_by_name(campaign: Path) -> None:
    with pytest.raises(RefusedError, match=r"no section \[certificate\].*laboratory\.email.*item\.serial"):
        export_from(SAMPLES / "corridor_crossed", "dcc")
    settings = campaign / "campaign.toml"
    settings.write_text(settings.read_text().replace('serial = "..."', "", 1).replace('identifier = "2025-0311"', ""))
    with pytest.raises(RefusedError, match=r"found no identifier, item\.serial;"):
        export_from(campaign, "dcc")


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ('country = "DE"', 'country = "Germany"', "certificate.country"),
        ("end = 2025-03-12", "end = 2025-02-12", "end is before begin"),
        ("end = 2025-03-12", 'end = "soon"', "certificate.end"),
        ('performed_at = "laboratory"', 'performed_at = "moon"', "certificate.performed_at"),
        ('role = "..."', 'role = "..."\nroel = 1', "certificate.persons.0.roel"),
    ],
)
def test_wrong_values_are_named(campaign: Path, old: str, new: str, where: str) -> None:
    settings = campaign / "campaign.toml"
    settings.write_text(settings.read_text().replace(old, new, 1))
    with pytest.raises(BadInputError, match=where):
        export_from(campaign, "dcc")


def test_a_result_folder_gives_the_same_bytes(campaign: Path, tmp_path: Path) -> None:
    write_result(calib.fit(campaign), tmp_path / "result")
    assert export_from(tmp_path / "result", "dcc") == export_from(campaign, "dcc")


def test_simulated_data_and_missing_traceability_are_declared(campaign: Path) -> None:
    settings = campaign / "campaign.toml"
    text = settings.read_text()
    settings.write_text(text.replace('certificate = "..."', "#"))
    declared = " ".join("".join(part.itertext()) for part in _root(campaign).iter(f"{{{NAMES['dcc']}}}declaration"))
    assert "SIMULATED DATA" in declared and "Traceability to the SI is not shown" in declared


def test_a_law_whose_check_failed_needs_a_reason(campaign: Path) -> None:
    table = campaign / "runs.csv"
    lines = table.read_text().splitlines()
    at = lines[0].split(",").index("session")
    kept = [
        lines[0],
        *(",".join("" if i == at else cell for i, cell in enumerate(line.split(","))) for line in lines[1:]),
    ]
    table.write_text("\n".join(kept) + "\n")
    with pytest.raises(RefusedError, match="doubtful"):
        export_from(campaign, "dcc")
    declared = " ".join(_root(campaign, "asked for by the customer").itertext())
    assert "asked for by the customer" in declared


def test_texts_cannot_break_the_document(campaign: Path) -> None:
    settings = campaign / "campaign.toml"
    text = settings.read_text().replace('name = "..."', r'name = "</dcc:x> &\u0007 <!DOCTYPE a>"', 1)
    settings.write_text(text)
    name = _root(campaign).findtext(".//dcc:calibrationLaboratory//dcc:content", "", NAMES)
    assert name == r"</dcc:x> &\x7 <!DOCTYPE a>"


def test_the_example_in_the_documentation_is_complete() -> None:
    assert certificate_of(tomllib.loads(EXAMPLE)["certificate"], "campaign.toml").identifier == "2025-0311"
