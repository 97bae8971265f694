"""Pairing photos by lens and time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from telewide.capture.exif import PhotoFacts
from telewide.capture.lens_choice import LensChoice
from telewide.capture.pairing import PairedRoll, RollPhoto, pair_photos

NOON = datetime(2026, 5, 1, 12)
LENSES = {"U": (1.54, 13.0), "W": (4.25, 26.0), "T": (6.0, 52.0)}


def photo(
    name: str, second: float, *, lens: str | None = None, kind: str = "jpeg", model: str = "P", **stated: object
) -> RollPhoto:
    """A photo whose name begins with its lens."""
    focal, f35 = LENSES[lens or name[0]]
    facts = {"focal_length_mm": focal, "f35_mm": f35, "taken": NOON + timedelta(seconds=second), **stated}
    return RollPhoto(Path(f"{name}.jpg"), PhotoFacts(kind, make="M", model=model, **facts))  # type: ignore[arg-type]


def named(roll: PairedRoll) -> list[tuple[str, str]]:
    return [(pair.tele.path.stem, pair.wide.path.stem) for pair in roll.pairs]


def reasons(roll: PairedRoll) -> dict[str, str]:
    return {one.photo.path.stem: one.reason for one in roll.unpaired}


def test_the_nearest_in_time_go_together() -> None:
    photos = [
        photo("W1", 0),
        photo("T1", 0.4),
        photo("T2", 100),
        photo("W2", 101.5),
        photo("W3", 200),
        photo("T3", 190),
    ]
    roll = pair_photos(photos, choice=LensChoice())
    assert named(roll) == [("T1", "W1"), ("T2", "W2"), ("T3", "W3")]
    assert [pair.seconds_apart for pair in roll.pairs] == pytest.approx([-0.4, 1.5, 10])
    assert [pair.ratio for pair in roll.pairs] == [2, 2, 2]
    assert roll.unpaired == ()


def test_both_must_be_nearest_and_the_rest_hears_why() -> None:
    photos = [photo("W1", 0), photo("T1", 1), photo("W2", 2.5), photo("T2", 40), photo("W3", 51)]
    roll = pair_photos(photos, choice=LensChoice())
    assert named(roll) == [("T1", "W1")]
    told = reasons(roll)
    assert told["W2"] == "T1.jpg is nearer to W1.jpg"
    assert told["T2"] == "the nearest photo of the other lens, W3.jpg, is 11.0 s away; 10 s at most are allowed"
    assert "T2.jpg, is 11.0 s away" in told["W3"]
    assert named(pair_photos(photos, choice=LensChoice(max_seconds=11))) == [("T1", "W1"), ("T2", "W3")]


def test_every_photo_is_paired_or_told_why(rng: np.random.Generator) -> None:
    photos = [photo(f"{'TW'[i % 2]}{i:03d}", float(rng.uniform(0, 900))) for i in range(200)]
    roll = pair_photos(photos, choice=LensChoice())
    seen = [one for pair in roll.pairs for one in (pair.tele, pair.wide)] + [left.photo for left in roll.unpaired]
    assert sorted(one.path for one in seen) == sorted(one.path for one in photos)
    assert all(left.reason for left in roll.unpaired)
    assert all(abs(pair.seconds_apart) <= 10 for pair in roll.pairs)
    assert len(roll.pairs) > 30
    again = pair_photos(photos[::-1], choice=LensChoice())
    assert named(again) == named(roll)


@pytest.mark.parametrize("order", ["TWTW", "WTWT", "TWWTTW"])
@pytest.mark.parametrize("step", [2.0, 0.1])
def test_photos_taken_in_turns_at_equal_intervals_all_find_a_partner(order: str, step: float) -> None:
    photos = [photo(f"{lens}{i}", step * i) for i, lens in enumerate(order)]
    roll = pair_photos(photos, choice=LensChoice())
    assert [abs(pair.seconds_apart) for pair in roll.pairs] == pytest.approx([step] * (len(order) // 2), abs=1e-6)
    assert roll.unpaired == ()


def test_photos_of_one_second_are_paired_by_name() -> None:
    photos = [photo(name, 5) for name in ("T2", "W1", "T1", "W2", "T3")]
    roll = pair_photos(photos, choice=LensChoice())
    assert named(roll) == [("T1", "W1"), ("T2", "W2")]
    assert reasons(roll) == {"T3": "W1.jpg is as near to T1.jpg and goes with that one"}


def test_phones_are_not_mixed() -> None:
    photos = [photo("W1", 0), photo("T1", 5), photo("W2", 4.9, model="Q"), photo("T2", 0.1, model="Q")]
    assert named(pair_photos(photos, choice=LensChoice())) == [("T2", "W2"), ("T1", "W1")]


def test_of_three_lenses_those_with_most_pairs_are_taken() -> None:
    often = [photo(f"{lens}{i}", 100 * i + k) for i in range(3) for k, lens in enumerate("UW")]
    roll = pair_photos([*often, photo("T9", 2)], choice=LensChoice())
    assert named(roll) == [("W0", "U0"), ("W1", "U1"), ("W2", "U2")]
    assert reasons(roll) == {"T9": "taken with the 6 mm lens; pairs are made of 1.54 mm and 4.25 mm"}


def test_of_three_lenses_used_alike_the_longest_two_are_taken() -> None:
    photos = [photo(f"{lens}{i}", 100 * i + k) for i in range(3) for k, lens in enumerate("UWT")]
    assert named(pair_photos(photos, choice=LensChoice())) == [("T0", "W0"), ("T1", "W1"), ("T2", "W2")]
    asked = pair_photos(photos, choice=LensChoice(wide_mm=1.54))
    assert named(asked) == [("T0", "U0"), ("T1", "U1"), ("T2", "U2")]
    none = pair_photos(photos, choice=LensChoice(tele_mm=9, wide_mm=4.25))
    assert none.pairs == ()
    assert reasons(none)["T0"].startswith("the lenses asked for, 4.25 mm and 9 mm, are not both there")


def four_lenses(second: float, name: str) -> list[RollPhoto]:
    """One scene through all lenses of a phone: 13, 24, 70 and 230 mm equivalent."""
    lenses = {"U": (2.2, 13.0), "W": (6.3, 24.0), "T": (7.9, 70.0), "L": (18.6, 230.0)}
    return [
        photo(f"{lens}{name}", second + k, lens="W", focal_length_mm=focal, f35_mm=f35)
        for k, (lens, (focal, f35)) in enumerate(lenses.items())
    ]


def test_of_four_lenses_the_main_one_is_wide_and_tele_the_one_that_sees_enough_of_it() -> None:
    roll = pair_photos([*four_lenses(0, "1"), *four_lenses(100, "2")], choice=LensChoice())
    assert named(roll) == [("T1", "W1"), ("T2", "W2")]
    (lenses,) = roll.lenses
    assert (lenses.chosen.wide.focal_length_mm, lenses.chosen.tele.focal_length_mm) == (6.3, 7.9)
    assert (lenses.others[0].wide.focal_length_mm, lenses.others[0].tele.focal_length_mm) == (6.3, 18.6)
    assert lenses.others[0].n_pairs == 2
    assert reasons(roll)["L1"] == "taken with the 18.6 mm lens; pairs are made of 6.3 mm and 7.9 mm"


def test_photos_paired_before_still_tell_the_lenses() -> None:
    """The lenses that are left do not make pairs of their own in a second import."""
    photos = [*four_lenses(0, "1"), *four_lenses(100, "2")]
    known = frozenset(Path(f"{name}.jpg") for name in ("T1", "W1", "T2"))
    roll = pair_photos(photos, choice=LensChoice(), known=known)
    assert roll.pairs == ()
    assert set(reasons(roll)) == {"W2", "U1", "U2", "L1", "L2"}
    assert reasons(roll)["W2"] == "no photo of the other lens is left to go with it"


def test_a_lens_whose_focal_length_varies_is_one_lens() -> None:
    """As zoom and focus move it by less than a step from photo to photo."""
    steps = range(9)
    photos = [photo(f"T{i}", 100 * i, focal_length_mm=13 + 0.1 * i, f35_mm=70 + i // 2) for i in steps]
    photos += [photo(f"W{i}", 100 * i + 1) for i in steps]
    roll = pair_photos(photos, choice=LensChoice())
    assert len(roll.pairs) == len(steps)
    assert roll.unpaired == ()
    assert pair_photos(photos, choice=LensChoice(tele_mm=13.8)).unpaired == ()


@pytest.mark.parametrize("f35", [26.0, None])
def test_a_lens_that_states_two_focal_lengths_is_one_where_its_view_is_one(f35: float | None) -> None:
    photos = [photo(f"W{i}", 100 * i, focal_length_mm=(5.58, 6.02)[i % 2], f35_mm=f35) for i in range(6)]
    photos += [photo(f"T{i}", 100 * i + 1, focal_length_mm=15.6, f35_mm=f35 and 77.0) for i in range(6)]
    roll = pair_photos(photos, choice=LensChoice())
    if f35 is not None:
        assert len(roll.pairs) == 6
    else:  # nothing tells them from two lenses: the others are named
        assert len(roll.pairs) == 3
        assert {other.n_pairs for other in roll.lenses[0].others} == {3}
    assert all(left.reason for left in roll.unpaired)


def test_two_lenses_of_nearly_one_focal_length_stay_two_where_their_views_differ() -> None:
    photos = [photo("W1", 0, focal_length_mm=5.4, f35_mm=26.0), photo("T1", 1, focal_length_mm=5.9, f35_mm=29.0)]
    assert named(pair_photos(photos, choice=LensChoice())) == [("T1", "W1")]


def test_a_digital_crop_takes_no_partner_away() -> None:
    crop = photo("X1", 0.1, lens="W", f35_mm=52.0)
    roll = pair_photos([photo("W1", 0), crop, photo("T1", 3)], choice=LensChoice())
    assert named(roll) == [("T1", "W1")]
    assert "digital crop of the 4.25 mm lens" in reasons(roll)["X1"]


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        ({"focal_length_mm": None}, "states no focal length"),
        ({"taken": None}, "states no time"),
        ({"digital_zoom_ratio": 1.5}, "DigitalZoomRatio is 1.50"),
    ],
)
def test_photos_that_cannot_be_placed(stated: dict[str, object], told: str) -> None:
    roll = pair_photos([photo("W1", 0), photo("T1", 1, **stated)], choice=LensChoice())
    assert roll.pairs == ()
    assert told in reasons(roll)["T1"]
    assert reasons(roll)["W1"] == "its camera's photos here are all from one lens, 4.25 mm"


def test_time_zones_count_where_all_photos_have_one() -> None:
    east = timezone(timedelta(hours=2))
    moments = {
        "T1": (NOON + timedelta(hours=2)).replace(tzinfo=east),
        "W1": (NOON + timedelta(seconds=1)).replace(tzinfo=UTC),
    }
    zoned = [photo(name, 0, taken=moment) for name, moment in moments.items()]
    assert named(pair_photos(zoned, choice=LensChoice())) == [("T1", "W1")]
    mixed = [photo("T1", 0, taken=NOON.replace(tzinfo=east)), photo("W1", 1)]
    assert named(pair_photos(mixed, choice=LensChoice())) == [("T1", "W1")]


def test_one_photo_without_a_time_zone_leaves_the_zones_of_the_others() -> None:
    """Two scenes in two zones: by the clock alone the second scene's photos would be hours apart."""
    east, west = timezone(timedelta(hours=2)), timezone(timedelta(hours=1))
    photos = [
        photo("T1", 0, taken=NOON.replace(tzinfo=east)),
        photo("W1", 0, taken=(NOON - timedelta(hours=1, seconds=-3)).replace(tzinfo=west)),
        photo("T2", 0, taken=(NOON + timedelta(hours=5)).replace(tzinfo=east)),
        photo("W2", 0, taken=NOON + timedelta(hours=5, seconds=2)),
    ]
    roll = pair_photos(photos, choice=LensChoice())
    assert named(roll) == [("T1", "W1"), ("T2", "W2")]
    assert [pair.seconds_apart for pair in roll.pairs] == [3, 2]


def test_raw_is_taken_with_raw_and_its_twin_with_jpeg() -> None:
    def raw(name: str, second: float) -> RollPhoto:
        plain = photo(name, second, kind="raw")
        twin = photo(f"{name}-twin", second, lens=name[0])
        return RollPhoto(plain.path, plain.facts, twin)

    both = pair_photos([raw("T1", 0), raw("W1", 1)], choice=LensChoice())
    assert named(both) == [("T1", "W1")]
    one = pair_photos([raw("T1", 0), photo("W1", 1)], choice=LensChoice())
    assert named(one) == [("T1-twin", "W1")]
    (mixed,) = pair_photos([photo("T1", 0, kind="raw"), photo("W1", 1)], choice=LensChoice()).pairs
    assert mixed.notes == ("one is RAW, the other is not: their lens distortion differs",)


def test_photos_held_differently_are_noted() -> None:
    (pair,) = pair_photos([photo("T1", 0, hw=(40, 30)), photo("W1", 1, hw=(30, 40))], choice=LensChoice()).pairs
    assert pair.notes == ("one is upright, the other lies on its side",)


def test_no_photos() -> None:
    assert pair_photos([], choice=LensChoice()) == PairedRoll((), (), ())
