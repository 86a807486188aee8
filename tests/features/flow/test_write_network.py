"""``write.network``: tubes of known radius, networks of known permeability, and OpenPNM itself."""

import csv

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.numerics.regions import parted, regions_of
from sppm_pipeline.features.flow.stages.write_network import WriteNetwork, cut_at_faces, measured, permeability
from sppm_pipeline.method.fields.microstructure import Microstructure, pieces_from_graph
from sppm_pipeline.method.kernels.profiles import TUNNEL_PROFILES, omega_from_radius
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

LEVEL, RADIUS = 0.25, 0.1


def structure(centers, edges, shift, radius=RADIUS, edge="4 mm", pore=0.02):
    placed = np.array(centers) * (1.0 if edge is None else 4.0)  # mm
    graph = TunnelGraph.from_arrays(PoreSet.from_array(placed, edge=edge), edges, shift)
    profile = TUNNEL_PROFILES["squared"]
    mu = np.full(len(edges), profile.mu(radius, LEVEL, "tunnel radius"))
    omega = np.full(len(centers), omega_from_radius(pore, LEVEL))
    cell = Cell() if edge is None else Cell(4.0, physical=True)
    return Microstructure(cell, graph, pieces_from_graph(graph, omega, mu, "squared"), LEVEL)


def tube(**changed):
    """A tube along x through two pores, which are too thin to be seen in it."""
    return structure([[0.2, 0.4, 0.7], [0.7, 0.4, 0.7]], [[0, 1], [1, 0]], [[0, 0, 0], [1, 0, 0]], **changed)


def lattice():
    """Two by two tubes along each axis; more throats than pores, as in cells of pores with three tunnels or more."""
    places = np.stack(np.meshgrid(*[[0.2, 0.7]] * 3, indexing="ij"), -1).reshape(8, 3)
    number = np.arange(8)
    edges = [[i, i ^ bit] for bit in (4, 2, 1) for i in number]
    shift = [np.eye(3, dtype=int)[axis] * ((i & bit) > 0) for axis, bit in enumerate((4, 2, 1)) for i in number]
    return structure(places, edges, shift)


def written(source, tmp_path, name="n.npz", **options):
    context = PlainContext(directory=tmp_path)
    WriteNetwork(path=name, **options).run(context, source)
    if name.endswith("npz"):
        with np.load(tmp_path / name) as file:
            return dict(file), context
    return (tmp_path / name).read_text(), context


@pytest.fixture(scope="module")
def tangle():
    """Nine pores, each joined to three others or their images up to a cell away, and conductances of any size."""
    rng = np.random.default_rng(4)
    edges = np.concatenate([np.stack([np.arange(9), (np.arange(9) + k) % 9], 1) for k in (1, 2, 4)])
    return rng.random((9, 3)), edges, rng.integers(-1, 2, (27, 3)), rng.random(27)


class TestContract(StageContract):
    def stages(self):
        return [WriteNetwork(resolution=16, path="n.csv")]

    def inputs(self):
        return {"source": tube()}


@pytest.mark.parametrize("swing", [0.0, 0.02])
def test_a_tube_has_its_radius_and_resistance(swing):
    """A cylinder, and one whose radius changes slowly: Hagen and Poiseuille in each slice."""
    n = 64
    place = (np.arange(n) + 0.5) / n
    z, y, x = np.meshgrid(place, place, place, indexing="ij")
    values = (RADIUS + swing * np.cos(2 * np.pi * x) - np.hypot(y - 0.41, z - 0.97 + (z < 0.47))).astype(np.float32)
    network = cut_at_faces(np.array([[0.2, 0.41, 0.97]]), np.zeros((1, 2), int), np.array([[1, 0, 0]]))
    found = measured(network, values)
    assert found.throat_radius.min() == pytest.approx(RADIUS - swing, rel=0.005)
    assert found.pore_radius[0] == pytest.approx(RADIUS + swing * np.cos(0.4 * np.pi), rel=0.01)
    s = (np.arange(1000) + 0.5) / 1000
    resistance = 8 / np.pi * np.mean((RADIUS + swing * np.cos(2 * np.pi * s)) ** -4.0)
    k = permeability(network, found.size_factor)
    # where the wall slopes, a ball touches it before it is as wide as the tube
    assert k[0, 0] == pytest.approx(1 / resistance, rel=0.03 if swing else 0.01)
    assert np.abs(k).sum() == pytest.approx(k[0, 0], rel=1e-9)
    volume = np.pi * (RADIUS**2 + swing**2 / 2)
    assert found.pore_volume.sum() == pytest.approx(volume, rel=0.02)


def test_solid_on_an_axis_closes_the_throat():
    network = cut_at_faces(np.full((1, 3), 0.5), np.zeros((2, 2), int), np.eye(3, dtype=int)[:2])
    values = np.ones((16, 16, 16), np.float32)
    values[:, 2:5] = -1  # y
    found = measured(network, values)
    assert (found.throat_radius > 0).tolist() == [True, True, True, False]
    k = permeability(network, found.size_factor)
    assert k[0, 0] > 0
    assert k[1, 1] == 0


def test_lengths_are_in_meters(tmp_path):
    source = tube()
    data, context = written(source, tmp_path, resolution=32)
    assert data["throat.inscribed_diameter"] == pytest.approx(8e-3 * RADIUS, rel=0.02)
    assert np.array(context.reported["network_k_m2"]) == pytest.approx(np.array(context.reported["network_k"]) * 16e-6)
    assert data["throat.total_length"].sum() == pytest.approx(4e-3)
    outside = data["throat.total_length"] - data["pore.inscribed_diameter"][data["throat.conns"]].sum(1) / 2
    assert data["throat.length"][0] == pytest.approx(outside[0])
    assert outside[2] < 0 < data["throat.length"][2]  # the pores at its ends overlap
    assert data["throat.hydraulic_size_factors"][0] == pytest.approx(np.pi / 8 * (4e-3 * RADIUS) ** 4 / 2e-3, rel=0.3)
    assert data["pore.volume"].sum() == pytest.approx((source.sample(cell_centers(32)) >= 0).mean() * 64e-9)


def test_a_lattice_of_tubes_is_known():
    """pi r^4 / 8 along each axis; in series and in parallel conductances add up as they do for currents."""
    lattice = cut_at_faces(np.full((1, 3), 0.5), np.zeros((3, 2), int), np.eye(3, dtype=int))
    assert len(lattice.coords) == 7  # each tube is cut once, and has two ends on faces
    half = np.pi * 0.1**4 / 8 / np.linalg.norm(lattice.vectors, axis=1)
    assert permeability(lattice, half) == pytest.approx(np.pi * 0.1**4 / 8 * np.eye(3), rel=1e-12)
    two = np.array([[0.2, 0.5, 0.5], [0.6, 0.5, 0.5]])
    row = cut_at_faces(two, np.array([[0, 1], [0, 1], [1, 0]]), np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0]]))
    assert row.tunnel.tolist() == [0, 1, 2, 2]
    # two tubes in parallel, and the two parts of the third in a row
    found = permeability(row, np.array([2.0, 3.0, 10.0, 15.0]))
    assert found[0, 0] == pytest.approx(1 / (1 / (2 + 3) + 1 / 10 + 1 / 15), rel=1e-12)


def test_cuts_change_nothing(tangle):
    """Wherever the cell begins, and against dense equations of the network that is not cut."""
    centers, edges, shift, factor = tangle
    rise = np.zeros((27, 9))
    np.add.at(rise, (np.arange(27), edges[:, 0]), -1)
    np.add.at(rise, (np.arange(27), edges[:, 1]), 1)
    vectors = centers[edges[:, 1]] + shift - centers[edges[:, 0]]
    root = np.sqrt(factor)[:, None]
    pressure = np.linalg.lstsq(root * rise, -root * vectors, rcond=None)[0]
    drop = root * (vectors + rise @ pressure)
    expected = drop.T @ drop
    for moved in (np.zeros(3), np.array([0.37, 0.81, 0.55]), -centers[3]):
        place = centers + moved
        turned = np.floor(place).astype(int)
        network = cut_at_faces(place - turned, edges, shift + turned[edges[:, 1]] - turned[edges[:, 0]])
        ends = network.coords[network.conns]
        assert ends[:, 1] - ends[:, 0] == pytest.approx(network.vectors, abs=1e-12)
        assert network.coords.min() >= 0
        assert network.coords.max() <= 1
        images = network.coords - network.coords[network.image_of]
        assert images == pytest.approx(np.round(images), abs=1e-12)
        whole, part = np.linalg.norm(vectors, axis=1), np.linalg.norm(network.vectors, axis=1)
        assert np.bincount(network.tunnel, part) == pytest.approx(whole)
        cut = (factor * whole)[network.tunnel] / part
        assert permeability(network, cut) == pytest.approx(expected, rel=1e-9)


def test_tables_and_arrays_agree(tmp_path):
    data, context = written(tube(), tmp_path, resolution=16)
    text, _ = written(tube(), tmp_path, "n.csv", resolution=16)
    assert written(tube(), tmp_path, "n.csv", resolution=16)[0] == text
    rows = list(csv.DictReader(text.splitlines()))
    for name, array in data.items():
        for k, column in enumerate(array.reshape(len(array), -1).T):
            found = [row[name if array.ndim == 1 else f"{name}[{k}]"] for row in rows]
            assert found[len(array) :] == [""] * (len(rows) - len(array))
            assert [str(value) for value in column.tolist()] == found[: len(array)]
    assert context.reported["throats"] == 3
    assert data["pore.xmin"].sum() == data["pore.xmax"].sum() == 1
    assert not data["pore.ymin"].any()
    assert data["pore.image_of"].tolist() == [0, 1, 2, 2]


def test_what_has_no_network(tmp_path):
    with pytest.raises(ConfigError, match="physical size"):
        written(tube(edge=None), tmp_path)
    sized = written(tube(edge=None), tmp_path, resolution=16, cell=Length(4.0, "mm"))[0]
    assert sized["pore.coords"][0, 0] == pytest.approx(0.8e-3)
    with pytest.raises(DesignError, match="no tunnels"):
        written(structure([[0.5] * 3], np.empty((0, 2), int), np.empty((0, 3), int)), tmp_path, resolution=8)


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_openpnm_opens_it(kind, tmp_path):
    """And its own flow through the box of the cell has the same permeability, along tubes."""
    openpnm = pytest.importorskip("openpnm")
    _, context = written(lattice(), tmp_path, f"n.{kind}", resolution=16)
    if kind == "csv":
        network = openpnm.io.network_from_csv(tmp_path / "n.csv")
    else:
        with np.load(tmp_path / "n.npz") as file:
            network = openpnm.io.network_from_porespy(dict(file))
    assert (network.Np, network.Nt) == (32, 36)
    fluid = openpnm.phase.Phase(network=network)
    fluid["pore.viscosity"] = fluid["throat.viscosity"] = 1e-3
    fluid.add_model(
        propname="throat.hydraulic_conductance",
        model=openpnm.models.physics.hydraulic_conductance.generic_hydraulic,
    )
    flow = openpnm.algorithms.StokesFlow(network=network, phase=fluid)
    flow.set_value_BC(pores=network.pores("xmin"), values=1.0)
    flow.set_value_BC(pores=network.pores("xmax"), values=0.0)
    flow.run()
    rate = float(flow.rate(pores=network.pores("xmin"))[0])
    assert rate * 1e-3 / 4e-3 == pytest.approx(context.reported["network_k_m2"][0][0], rel=1e-6)


def rooms(n=40):
    """Three round rooms in a row, joined by two round channels, of which the outer ones lead to the sides."""
    x, y, z = (np.indices((n, n, n)) + 0.5) / n
    from_axis = np.hypot(y - 0.5, z - 0.5)
    void = from_axis < 0.07
    for center in (0.2, 0.5, 0.8):
        void |= np.hypot(x - center, from_axis) < 0.13
    return void


def blob(n=56):
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(np.random.default_rng(1).random((n, n, n)), 3.5)
    return values > np.median(values)


def test_rooms_of_an_image_are_pores_and_channels_are_throats(tmp_path):
    void = rooms()
    image = Voxels.from_array(~void, spacing=0.1)
    found, context = written(image, tmp_path)
    assert context.reported["pores"] == 5  # and two openings
    assert found["pore.volume"].sum() == pytest.approx(1e-12 * np.count_nonzero(void), rel=1e-9)
    assert found["pore.xmin"].sum() == found["pore.xmax"].sum() == 1
    assert not found["pore.ymin"].any()
    rooms_at = np.sort(found["pore.coords"][found["pore.volume"] > 0][:, 0])
    assert rooms_at == pytest.approx([0.8e-3, 2e-3, 3.2e-3], abs=1e-4)
    assert found["throat.conns"].shape == (4, 2)
    # distances are those to centers of voxels, of which these channels have less than six
    diameter = found["throat.inscribed_diameter"]
    assert diameter == pytest.approx(np.full(4, 2 * 0.07 * 4e-3), rel=0.26)
    # between channels as wide as the throats all along, and ones as wide as the rooms
    k = context.reported["network_k_m2"]
    tube = np.pi * (diameter.mean() / 2) ** 4 / 8 / (4e-3) ** 2
    assert tube < k[0][0] < 8 * tube
    assert not np.any(np.array(k)[1:])
    turned, _ = written(Voxels.from_array(~void.T, spacing=0.1), tmp_path)
    assert np.sort(turned["pore.coords"][:, 2]) == pytest.approx(np.sort(found["pore.coords"][:, 0]), abs=1.01e-4)


def test_a_round_channel_has_the_flow_of_hagen_and_poiseuille():
    _, y, z = np.indices((12, 41, 41)) - 20.0
    found = regions_of(np.hypot(y, z) < 12, (1.0, 1.0, 1.0))
    assert len(found.size_factor) == 2
    assert 12 / np.sum(1 / found.size_factor) == pytest.approx(np.pi * 12**4 / 8, rel=0.1)


def test_regions_fill_the_void_and_voxels_may_be_long():
    void = blob()
    regions, distance = parted(void, (1.0, 1.0, 1.0))
    assert np.array_equal(regions > 0, distance > 0)
    assert np.unique(regions).size == regions.max() + 1
    twice = regions_of(np.repeat(rooms(24), 2, axis=2), (1.0, 1.0, 0.5))
    assert np.count_nonzero(twice.volume) == 3


def test_images_without_a_void_or_a_size_are_refused(tmp_path):
    for solid, word in ((np.ones((8, 8, 8), bool), "all solid"), (np.zeros((8, 8, 8), bool), "all void")):
        with pytest.raises(DesignError, match=word):
            written(Voxels.from_array(solid, spacing=0.1), tmp_path)
    with pytest.raises(ConfigError, match="no physical size"):
        written(Voxels.from_array(~rooms(16)), tmp_path)


def test_porespy_parts_an_image_likewise():
    porespy = pytest.importorskip("porespy")
    void = blob()
    ours = regions_of(void, (1.0, 1.0, 1.0))
    theirs = porespy.networks.snow2(void, boundary_width=0).network
    pores = np.count_nonzero(ours.volume)
    inner = ours.conns[:, 1] < pores
    assert pores == pytest.approx(len(theirs["pore.coords"]), rel=0.08)
    assert np.count_nonzero(inner) == pytest.approx(len(theirs["throat.conns"]), rel=0.1)
    assert 2 * ours.throat[inner].mean() == pytest.approx(theirs["throat.inscribed_diameter"].mean(), rel=0.05)
