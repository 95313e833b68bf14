"""A run's files of different views, regions and layers are different files, whatever they are called."""

from itertools import combinations, product
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.run_folder import exact_normal_path, layer_path, layers_of, mask_path, render_path, target_path

NAMES = st.lists(st.text("ab-", min_size=1, max_size=5), min_size=2, max_size=4, unique=True)


@given(views=NAMES, parts=NAMES)
def test_no_two_names_share_a_file(views, parts):
    run = Path("run")
    files = [path(run, view) for path in (render_path, target_path, exact_normal_path) for view in views]
    files += [path(run, view, part) for path in (mask_path, layer_path) for view, part in product(views, parts)]
    assert all(one != other for one, other in combinations(files, 2))


def test_layers_are_the_views_own(tmp_path):
    for view, layer in (("a", "beta"), ("a-b", "beta"), ("a-b", "c"), ("a", "b-c")):
        layer_path(tmp_path, view, layer).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (1, 1)).save(layer_path(tmp_path, view, layer))
    assert sorted(layers_of(tmp_path, "a")) == ["b-c", "beta"]
    assert sorted(layers_of(tmp_path, "a-b")) == ["beta", "c"]
