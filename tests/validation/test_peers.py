"""Numbers of other codes, and with which of ours they are comparable."""

from isphcli.validation.peers import TABLE, difference, load_peers, peers_of
from tests.validation.ladders import case


def test_the_table_of_other_codes():
    peers = load_peers(TABLE)
    assert len(peers) > 20 and {p.kind for p in peers} == {"taylor_green", "taylor_green_3d", "sphere_array"}
    for peer in peers:
        assert 0 < abs(peer.error) < 1 and peer.points > 0 and peer.source and peer.command and peer.machine
        assert peer.cpu_seconds is None or peer.cpu_seconds > 0


def test_only_the_same_flow_is_comparable():
    def codes(name, *overrides):
        return {(peer.code, peer.points) for peer, why in peers_of(case(name, *overrides)) if not why}

    assert ("PySPH ISPH", 64) in codes("taylor_green_2d")
    assert ("implicit-sph", 128) in codes("taylor_green_2d")
    assert ("implicit-sph", 32) not in codes("taylor_green_2d")  # at another time
    assert codes("taylor_green_2d_re100") == {("PySPH ISPH", n) for n in (25, 50, 100)} | {("PySPH EDAC", 50)}
    assert not codes("taylor_green_2d", "time.end=0.04") and not codes("taylor_green_3d")
    assert codes("sphere_array") == {("peclet-flow", 16), ("peclet-flow", 32)} and not peers_of(case("slit"))
    assert ("lbmpy, two relaxation times, AVX", 32) in codes(
        "sphere_array", "reference.parameters.fraction=0.2"
    )


def test_a_difference_is_said():
    peer = next(p for p in load_peers() if p.kind == "sphere_array" and p.code.startswith("lbmpy"))
    assert difference(case("sphere_array"), peer) == "fraction 0.2 against 0.216"
    unknown = next(p for p in load_peers() if p.kind == "taylor_green_3d")
    assert "time was not recorded" in difference(case("taylor_green_3d"), unknown)
