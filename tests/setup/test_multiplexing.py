"""Where the multiplexing of a DBC contradicts the data, `init` says so."""

from tests.setup.proposals import proposed
from tests.setup.vehicles import CELLS, german

MESSAGE = "HVB_Zelltemperaturen"
LINE = ' SG_ HVB_Zelltemp_{:02d} m{} : {}|8@0+ (0.5,-40) [-40|80] "°C" BMS\n'


def lines(first: int, mux: int) -> str:
    return LINE.format(first, mux, 15) + LINE.format(first + 1, mux, 23)


def found(folder, *told: tuple[str, str]):
    vehicle = german()
    vehicle.told = list(told)
    return proposed(vehicle, folder)


def temperatures(proposal) -> list[str]:
    return [p.path for p in proposal.of("surface")]


def test_a_sound_dbc_is_not_blamed(tmp_path) -> None:
    proposal = found(tmp_path)
    assert not [r for r in proposal.remarks if "multiplex" in r or "never takes" in r]
    assert not [path for path, why in proposal.unused if "multiplex" in why]
    assert len(temperatures(proposal)) == CELLS


def test_a_value_of_the_selector_that_the_dbc_does_not_know_is_told(tmp_path) -> None:
    proposal = found(tmp_path, (lines(7, 3), ""))
    (told,) = [r for r in proposal.remarks if "multiplex" in r]
    assert told == (
        f"{MESSAGE}: the DBC's multiplexing contradicts the data: HVB_Zelltemp_Mux takes 3 in 500 of 2000 frames, and "
        "the DBC has no signal for that"
    )
    assert len(temperatures(proposal)) == CELLS - 2


def test_signals_that_are_never_selected_are_told(tmp_path) -> None:
    proposal = found(tmp_path, (lines(7, 3), lines(7, 3) + lines(9, 4) + LINE.format(11, 5, 15)))
    (told,) = [r for r in proposal.remarks if "never takes" in r]
    names = "HVB_Zelltemp_09, HVB_Zelltemp_10, HVB_Zelltemp_11"
    assert told == f"{MESSAGE}: HVB_Zelltemp_Mux never takes 4, 5: {names} never come in 2000 frames"
    assert len(temperatures(proposal)) == CELLS


def test_a_signal_that_jumps_with_a_byte_of_its_frame_is_told_and_not_taken(tmp_path) -> None:
    """The DBC has one signal for four cells in turns."""
    vehicle = german()
    for k in range(CELLS):  # cells that differ by more than they move
        vehicle.values[f"{MESSAGE}.HVB_Zelltemp_{k + 1:02d}"] += 15 * (k // 2)
    every = [LINE.format(k, (k - 1) // 2, 15 if k % 2 else 23) for k in range(1, CELLS + 1)]
    vehicle.told = [*((line, "") for line in every[1:-1])]
    vehicle.told += [(every[-1].rstrip("\n"), ""), (every[0], every[0].replace(" m0 :", " :"))]
    vehicle.told.append(("Zelltemp_Mux M :", "Zelltemp_Mux :"))
    proposal = proposed(vehicle, tmp_path)
    why = dict(proposal.unused)[f"{MESSAGE}.HVB_Zelltemp_01"]
    assert "the DBC's multiplexing contradicts the data: it jumps with the byte 0 of its frame (0, 1, 2, 3)" in why
    assert f"{MESSAGE}.HVB_Zelltemp_01: {why}" in proposal.remarks
    assert not temperatures(proposal)
