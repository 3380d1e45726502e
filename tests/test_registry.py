"""Names become parts, wrong ones a suggestion."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from tomthumb import registry
from tomthumb.errors import TomThumbError, UnknownName


def test_every_built_in_name_leads_somewhere():
    for kind in ("associator", "estimator"):
        for name in registry.BUILT_IN[kind]:
            assert callable(registry.find(kind, name))


def test_parameters_are_keyword_arguments():
    assert registry.build("associator", "jcbb", {"gate": 0.95, "budget": 7}).gate == 0.95


def test_whole_numbers_become_floats_where_floats_are_wanted():
    gate = registry.build("associator", "jcbb", {"gate": 1}).gate
    assert isinstance(gate, float)


@pytest.mark.parametrize(("key", "value"), [("gate", "wide"), ("gate", True), ("budget", 0.5), ("faithful", 1)])
def test_a_value_of_the_wrong_type_is_refused(key, value):
    with pytest.raises(TomThumbError, match=f"associator.{key} must be"):
        registry.build("associator", "jcbb", {key: value})


def test_a_wrong_parameter_lists_the_valid_ones():
    with pytest.raises(UnknownName, match=r"did you mean 'gate'.*budget"):
        registry.build("associator", "jcbb", {"gates": 0.9})


def test_what_the_caller_supplies_is_no_parameter():
    with pytest.raises(UnknownName, match="'motion'"):
        registry.build("estimator", "ekf", {"motion": 1}, motion=None, sensor=None)


def test_faithful_is_left_out_where_unknown_and_kept_where_known():
    assert registry.build("associator", "gnn", {"faithful": True}) is not None
    assert registry.build("associator", "jcbb", {"faithful": True}).faithful


def test_a_wrong_name_gets_a_suggestion():
    with pytest.raises(UnknownName, match="unknown associator 'jcb'; did you mean 'jcbb'"):
        registry.find("associator", "jcb")
    with pytest.raises(UnknownName, match="unknown kind"):
        registry.find("associatr", "jcbb")


def test_a_module_and_a_class():
    found = registry.find("associator", "tomthumb.associators.jcbb:JointCompatibility")
    assert found is registry.find("associator", "jcbb")
    with pytest.raises(TomThumbError, match=r"no module 'tomthumb\.nowhere'"):
        registry.find("associator", "tomthumb.nowhere:Thing")


def test_a_file_and_a_class(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("class Mine:\n    def __init__(self, gate: float = 0.5):\n        self.gate = gate\n")
    assert registry.build("associator", f"{file}:Mine", {"gate": 0.25}).gate == 0.25
    assert registry.find("associator", f"{file}:Mine") is registry.find("associator", f"{file}:Mine")
    with pytest.raises(UnknownName, match="did you mean 'Mine'"):
        registry.find("associator", f"{file}:Mien")
    with pytest.raises(TomThumbError, match="no such file"):
        registry.find("associator", f"{tmp_path}/other.py:Mine")


def test_a_mistake_inside_the_file_keeps_its_own_error(tmp_path):
    file = tmp_path / "broken.py"
    file.write_text("import nothing_of_the_kind\n")
    with pytest.raises(ModuleNotFoundError, match="nothing_of_the_kind"):
        registry.find("associator", f"{file}:Mine")


def test_installed_packages_add_names_by_entry_point(tmp_path):
    info = tmp_path / "foreign-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tomthumb.associators]\nforeign = foreign:Foreign\nnn = foreign:Foreign\n")
    (tmp_path / "foreign.py").write_text("class Foreign:\n    pass\n")
    script = f"""
        import sys
        sys.path.insert(0, {str(tmp_path)!r})
        from tomthumb import registry
        assert "foreign" in registry.names("associator")
        assert "foreign" not in sys.modules, "imported before asked for"
        assert registry.find("associator", "foreign").__name__ == "Foreign"
        assert registry.find("associator", "nn").__name__ == "NearestNeighbour", "built-in comes first"
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=True)
