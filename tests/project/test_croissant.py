"""croissant.json describes the frozen sets and the samples of offline data as they are."""

import hashlib
import json

import pytest

from capsule_gym.evaluation.sets import load_set
from tests import ROOT

FILE = ROOT / "croissant.json"
CONTENT = json.loads(FILE.read_text(encoding="utf-8"))


def test_every_file_of_data_is_described_with_its_hash():
    paths = [*ROOT.glob("capsule_gym/data/sets/*.json"), *ROOT.glob("examples/data/**/*.hdf5")]
    hashes = {}
    for path in paths:
        name = path.relative_to(ROOT).as_posix()
        hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    described = {each["contentUrl"]: each["sha256"] for each in CONTENT["distribution"]}
    assert described == hashes
    sets = {path.stem for path in paths if path.suffix == ".json"}
    assert {each["name"] for each in CONTENT["recordSet"]} == sets


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", [each["name"] for each in CONTENT["recordSet"]])
def test_mlcroissant_reads_the_episodes_of_a_set(name):
    mlcroissant = pytest.importorskip("mlcroissant")
    dataset = mlcroissant.Dataset(FILE)
    assert not dataset.metadata.issues.warnings
    fields = ("M", "mu", "seed")
    found = [tuple(each[f"{name}/{field}"] for field in fields) for each in dataset.records(name)]
    plants = load_set(ROOT / "capsule_gym/data/sets" / f"{name}.json").plants
    assert found == [(plant.M, plant.mu, plant.seed) for plant in plants]
