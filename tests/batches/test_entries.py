"""Which recordings a batch has: paths, patterns, folders and TOML lists; labels and settings."""

import os
from pathlib import Path

import pytest

from carm_kin.batches.entries import entries
from carm_kin.errors import InputError

NOWHERE = Path("nowhere")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """monday/rec.csv, monday/more/extra.csv, tuesday/rec.csv, and what is no recording."""
    monkeypatch.chdir(tmp_path)
    for name in ("monday/rec.csv", "monday/more/extra.csv", "tuesday/rec.csv", "tuesday/.hidden.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    (tmp_path / "monday/rec.truth.json").write_text("{}")
    (tmp_path / "monday/notes.txt").write_text("")
    return tmp_path


def found(*paths: object, skipped: Path = NOWHERE, **given: object) -> dict[str, str]:
    """Label -> path as shown."""
    return {entry.label: entry.shown for entry in entries([str(path) for path in paths], given, skipped)}


def written(folder: Path, text: str) -> Path:
    (folder / "list.toml").write_text(text)
    return folder / "list.toml"


def refused(*paths: object, **given: object) -> str:
    with pytest.raises(InputError) as error:
        found(*paths, **given)
    return str(error.value)


def test_a_folder_is_searched_to_its_end_and_without_hidden_files(folder):
    everything = {"monday-rec": "monday/rec.csv", "tuesday-rec": "tuesday/rec.csv", "extra": "monday/more/extra.csv"}
    assert found(".") == everything
    assert found("monday") == {"rec": "monday/rec.csv", "extra": "monday/more/extra.csv"}


def test_the_folder_of_the_results_is_not_searched(folder):
    assert found(".", skipped=folder / "monday") == {"rec": "tuesday/rec.csv"}


def test_patterns_and_files(folder):
    assert found("*/rec.csv") == {"monday-rec": "monday/rec.csv", "tuesday-rec": "tuesday/rec.csv"}
    assert found("**/extra.csv") == {"extra": "monday/more/extra.csv"}
    assert found("tuesday/rec.csv", "monday/more/*.csv") == {"rec": "tuesday/rec.csv", "extra": "monday/more/extra.csv"}


def test_what_is_named_twice_is_there_once(folder):
    assert found("monday/rec.csv", "monday", folder / "monday/rec.csv").keys() == {"rec", "extra"}


def test_paths_are_absolute_for_workers_elsewhere(folder):
    (entry,) = entries(["tuesday"], {}, NOWHERE)
    assert entry.path == folder / "tuesday/rec.csv"


def test_labels_grow_by_folders_until_they_differ(folder):
    for name in ("a/x/rec.csv", "b/x/rec.csv"):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("x")
    assert found("a", "b").keys() == {"a-x-rec", "b-x-rec"}


def test_labels_that_differ_in_the_case_of_letters_alone_are_told_apart(folder):
    (folder / "tuesday/REC.csv").write_text("x")
    assert found("monday/rec.csv", "tuesday/REC.csv").keys() == {"monday-rec", "tuesday-REC"}


def test_a_file_whose_name_cannot_be_shown_is_shown_all_the_same(folder):
    name = b"bad\xff\n.csv"
    try:
        (folder / "odd").mkdir()
        Path(os.fsdecode(bytes(folder / "odd") + b"/" + name)).write_text("x")
    except OSError:
        pytest.skip("the file system takes no such name")
    (entry,) = entries(["odd"], {}, NOWHERE)
    assert entry.label == "bad__"
    assert entry.shown == "odd/bad\\udcff\\n.csv"
    assert entry.path.read_text() == "x"


def test_a_list_has_defaults_labels_and_settings_of_its_own(folder):
    text = """
[defaults]
solver = "closed_form"
sigma_t_mm = 0.5
options = { reject_outliers = false }

[[recording]]
path = "monday"

[[recording]]
path = "tuesday/rec.csv"
label = "patient 7"
solver = "kinematic"
options = { seed = 3 }
"""
    for path in (written(folder, text), "list.toml"):
        found = {entry.label: entry.settings for entry in entries([path], {}, NOWHERE)}
        assert found.keys() == {"rec", "extra", "patient 7"}
        assert {found[label].solver for label in ("rec", "extra")} == {"closed_form"}
        assert found["patient 7"].solver == "kinematic"
        assert {settings.sigma_t_mm for settings in found.values()} == {0.5}
        assert found["rec"].options == {"reject_outliers": False}
        assert found["patient 7"].options == {"seed": 3}


def test_what_the_command_says_goes_before_defaults_and_behind_what_a_recording_says(folder):
    text = '[defaults]\nsolver = "closed_form"\n[[recording]]\npath = "monday/rec.csv"\n'
    text += '[[recording]]\npath = "tuesday/rec.csv"\nlabel = "own"\nsolver = "direct"\n'
    given = {
        entry.label: entry.settings for entry in entries([written(folder, text)], {"solver": "kinematic"}, NOWHERE)
    }
    assert {label: settings.solver for label, settings in given.items()} == {"rec": "kinematic", "own": "direct"}


def test_a_list_is_relative_to_its_own_folder(folder, monkeypatch):
    path = written(folder / "monday", '[[recording]]\npath = "more/*.csv"\n')
    monkeypatch.chdir(folder / "tuesday")
    assert found(path).keys() == {"extra"}


def test_the_urdf_of_a_list_stands_beside_it_and_a_bundled_one_keeps_its_name(folder, monkeypatch):
    from carm_kin.machine.urdf import bundled_urdfs

    machine = bundled_urdfs()["mobile_nonisocentric"]
    (folder / "monday/own.urdf").write_bytes(machine.read_bytes())
    path = written(folder / "monday", '[defaults]\nurdf = "own.urdf"\n[[recording]]\npath = "rec.csv"\n')
    monkeypatch.chdir(folder / "tuesday")
    (entry,) = entries([path], {}, NOWHERE)
    assert entry.settings.urdf == str(folder / "monday/own.urdf")
    (entry,) = entries(["rec.csv"], {"urdf": "mobile_nonisocentric"}, NOWHERE)
    assert entry.settings.urdf == "mobile_nonisocentric"


@pytest.mark.parametrize(
    "text, expected",
    {
        "": "the list: 'recording' is missing",
        "recording = 3": "'recording' must be tables: [[recording]]",
        "[[recording]]\n": "[[recording]] number 1: 'path' is missing",
        "[[recordings]]\n": "'recordings' is unknown; it may have defaults, recording",
        "[[recording]\n": "no valid TOML",
        "defaults = 1\n[[recording]]\npath = 'monday'": "[defaults] must be a table",
        "[defaults]\npath = 'x'\n[[recording]]\npath = 'monday'": "[defaults]: 'path' is unknown",
        "[[recording]]\npath = 'none.csv'": "[[recording]] number 1: ",
        "[[recording]]\npath = 'none/*.csv'": "matches no file",
        "[[recording]]\npath = 3": "path must be a text, not 3",
        "[[recording]]\npath = '../x.csv'": "path '../x.csv' leads out of the folder of the list",
        "[[recording]]\npath = '/etc/passwd'": "leads out of the folder of the list",
        "[defaults]\nurdf = '../x.urdf'\n[[recording]]\npath = 'monday'": "[defaults]: urdf '../x.urdf' leads out",
        "[[recording]]\npath = 'monday'\nlabel = 'one'": "label 'one' is given to 2 recordings",
        "[[recording]]\npath = 'monday/rec.csv'\nlabel = '../up'": "cannot name a file",
        "[[recording]]\npath = 'monday/rec.csv'\nlabel = '.up'": "cannot name a file",
        "[[recording]]\npath = 'monday/rec.csv'\nlabel = 'a\\nb'": "cannot name a file",
        "[[recording]]\npath = 'monday/rec.csv'\nlabel = 3": "label must be a text, not 3",
        "[[recording]]\npath = 'monday'\nsolver = 'bogus'": "solver 'bogus' is unknown; it is one of chain, closed",
        "[[recording]]\npath = 'monday'\nsolvr = 'direct'": "'solvr' is unknown; it may have path, label, solver",
        "[[recording]]\npath = 'monday'\nsigma_t_mm = 0": "sigma_t_mm must be a finite number above 0",
        "[[recording]]\npath = 'monday'\ncross_validate = 1": "cross_validate needs at least 2 parts, not 1",
        "[[recording]]\npath = 'monday'\nsigma_t_mm = 'x'": "sigma_t_mm must be a finite number or null, not 'x'",
        "[[recording]]\npath = 'monday'\noptions = { bogus = 1 }": "solver 'kinematic' has no option 'bogus'",
        "[[recording]]\npath = 'monday'\nsolver = 'chain'": "the solver 'chain' needs a urdf",
        "[[recording]]\npath = 'monday'\nfree = 'lift'": "free: needs the calibration of a chain",
        "[[recording]]\npath = 'monday'\nurdf = 'bogus'": "no such file; bundled machines",
    }.items(),
)
def test_mistakes_in_a_list_are_named_with_its_file(text, expected, folder):
    path = written(folder, text.replace("'", '"'))
    message = refused(path)
    assert message.startswith(str(path))
    assert expected in message


@pytest.mark.parametrize(
    "path, expected",
    {
        "none.csv": "none.csv: no such file or folder",
        "none*.csv": "matches no file",
        "list.toml": "no such file",
        "empty": "holds no recording",
    }.items(),
)
def test_paths_without_a_recording_are_refused_before_the_work_starts(path, expected, folder):
    (folder / "empty").mkdir()
    assert expected in refused(path)


def test_a_label_is_at_most_as_long_as_a_file_name_may_be(folder):
    (folder / ("r" * 201 + ".csv")).write_text("x")
    assert "at most 200 bytes" in refused("r" * 201 + ".csv")


def test_one_recording_with_two_settings_needs_labels(folder):
    table = '[[recording]]\npath = "monday/rec.csv"\n'
    text = table + table + 'solver = "direct"\n'
    assert "would have the same label; give them labels in a list" in refused(written(folder, text))
    assert found(written(folder, text + 'label = "other"\n')).keys() == {"rec", "other"}
