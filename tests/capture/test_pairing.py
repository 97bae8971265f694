"""Pairing photos by lens and time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from telewide.capture.exif import PhotoFacts
from telewide.capture.pairing import LensChoice, RollPair, RollPhoto, Unpaired, pair_photos

NOON = datetime(2026, 5, 1, 12)
LENSES = {"U": (1.54, 13.0), "W": (4.25, 26.0), "T": (6.0, 52.0)}


def photo(
    name: str, second: float, *, lens: str | None = None, kind: str = "jpeg", model: str = "P", **stated: object
) -> RollPhoto:
    """A photo whose name begins with its lens."""
    focal, f35 = LENSES[lens or name[0]]
    facts = {"focal_length_mm": focal, "f35_mm": f35, "taken": NOON + timedelta(seconds=second), **stated}
    return RollPhoto(Path(f"{name}.jpg"), PhotoFacts(kind, make="M", model=model, **facts))  # type: ignore[arg-type]


def named(pairs: tuple[RollPair, ...]) -> list[tuple[str, str]]:
    return [(pair.tele.path.stem, pair.wide.path.stem) for pair in pairs]


def reasons(unpaired: tuple[Unpaired, ...]) -> dict[str, str]:
    return {one.photo.path.stem: one.reason for one in unpaired}


def test_the_nearest_in_time_go_together() -> None:
    photos = [
        photo("W1", 0),
        photo("T1", 0.4),
        photo("T2", 100),
        photo("W2", 101.5),
        photo("W3", 200),
        photo("T3", 190),
    ]
    pairs, unpaired = pair_photos(photos, choice=LensChoice())
    assert named(pairs) == [("T1", "W1"), ("T2", "W2"), ("T3", "W3")]
    assert [pair.seconds_apart for pair in pairs] == pytest.approx([-0.4, 1.5, 10])
    assert [pair.ratio for pair in pairs] == [2, 2, 2]
    assert unpaired == ()


def test_both_must_be_nearest_and_the_rest_hears_why() -> None:
    photos = [photo("W1", 0), photo("T1", 1), photo("W2", 2.5), photo("T2", 40), photo("W3", 51)]
    pairs, unpaired = pair_photos(photos, choice=LensChoice())
    assert named(pairs) == [("T1", "W1")]
    told = reasons(unpaired)
    assert told["W2"] == "T1.jpg is nearer to W1.jpg"
    assert told["T2"] == "the nearest photo of the other lens, W3.jpg, is 11.0 s away; 10 s at most are allowed"
    assert "T2.jpg, is 11.0 s away" in told["W3"]
    assert named(pair_photos(photos, choice=LensChoice(max_seconds=11))[0]) == [("T1", "W1"), ("T2", "W3")]


def test_every_photo_is_paired_or_told_why(rng: np.random.Generator) -> None:
    photos = [photo(f"{'TW'[i % 2]}{i:03d}", float(rng.uniform(0, 900))) for i in range(200)]
    pairs, unpaired = pair_photos(photos, choice=LensChoice())
    seen = [one for pair in pairs for one in (pair.tele, pair.wide)] + [left.photo for left in unpaired]
    assert sorted(one.path for one in seen) == sorted(one.path for one in photos)
    assert all(left.reason for left in unpaired)
    assert all(abs(pair.seconds_apart) <= 10 for pair in pairs)
    assert len(pairs) > 30
    again, _ = pair_photos(photos[::-1], choice=LensChoice())
    assert named(again) == named(pairs)


def test_phones_are_not_mixed() -> None:
    photos = [photo("W1", 0), photo("T1", 5), photo("W2", 4.9, model="Q"), photo("T2", 0.1, model="Q")]
    assert named(pair_photos(photos, choice=LensChoice())[0]) == [("T2", "W2"), ("T1", "W1")]


def test_of_three_lenses_those_with_most_pairs_are_taken() -> None:
    often = [photo(f"{lens}{i}", 100 * i + k) for i in range(3) for k, lens in enumerate("UW")]
    pairs, unpaired = pair_photos([*often, photo("T9", 2)], choice=LensChoice())
    assert named(pairs) == [("W0", "U0"), ("W1", "U1"), ("W2", "U2")]
    assert reasons(unpaired) == {"T9": "taken with the 6 mm lens; pairs are made of 1.54 and 4.25 mm"}


def test_of_three_lenses_used_alike_the_longest_two_are_taken() -> None:
    photos = [photo(f"{lens}{i}", 100 * i + k) for i in range(3) for k, lens in enumerate("UWT")]
    assert named(pair_photos(photos, choice=LensChoice())[0]) == [("T0", "W0"), ("T1", "W1"), ("T2", "W2")]
    asked, _ = pair_photos(photos, choice=LensChoice(wide_mm=1.54))
    assert named(asked) == [("T0", "U0"), ("T1", "U1"), ("T2", "U2")]
    none, unpaired = pair_photos(photos, choice=LensChoice(tele_mm=9, wide_mm=4.25))
    assert none == ()
    assert reasons(unpaired)["T0"].startswith("the lenses asked for, 4.25 mm and 9 mm, are not both there")


def test_a_digital_crop_takes_no_partner_away() -> None:
    crop = photo("X1", 0.1, lens="W", f35_mm=52.0)
    pairs, unpaired = pair_photos([photo("W1", 0), crop, photo("T1", 3)], choice=LensChoice())
    assert named(pairs) == [("T1", "W1")]
    assert "digital crop of the 4.25 mm lens" in reasons(unpaired)["X1"]


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        ({"focal_length_mm": None}, "states no focal length"),
        ({"taken": None}, "states no time"),
        ({"digital_zoom_ratio": 1.5}, "DigitalZoomRatio is 1.50"),
    ],
)
def test_photos_that_cannot_be_placed(stated: dict[str, object], told: str) -> None:
    pairs, unpaired = pair_photos([photo("W1", 0), photo("T1", 1, **stated)], choice=LensChoice())
    assert pairs == ()
    assert told in reasons(unpaired)["T1"]
    assert reasons(unpaired)["W1"] == "its camera's photos here are all from one lens, 4.25 mm"


def test_time_zones_count_where_all_photos_have_one() -> None:
    east = timezone(timedelta(hours=2))
    moments = {
        "T1": (NOON + timedelta(hours=2)).replace(tzinfo=east),
        "W1": (NOON + timedelta(seconds=1)).replace(tzinfo=UTC),
    }
    zoned = [photo(name, 0, taken=moment) for name, moment in moments.items()]
    assert named(pair_photos(zoned, choice=LensChoice())[0]) == [("T1", "W1")]
    mixed = [photo("T1", 0, taken=NOON.replace(tzinfo=east)), photo("W1", 1)]
    assert named(pair_photos(mixed, choice=LensChoice())[0]) == [("T1", "W1")]


def test_raw_is_taken_with_raw_and_its_twin_with_jpeg() -> None:
    def raw(name: str, second: float) -> RollPhoto:
        plain = photo(name, second, kind="raw")
        twin = photo(f"{name}-twin", second, lens=name[0])
        return RollPhoto(plain.path, plain.facts, twin)

    both, _ = pair_photos([raw("T1", 0), raw("W1", 1)], choice=LensChoice())
    assert named(both) == [("T1", "W1")]
    one, _ = pair_photos([raw("T1", 0), photo("W1", 1)], choice=LensChoice())
    assert named(one) == [("T1-twin", "W1")]
    (mixed,), _ = pair_photos([photo("T1", 0, kind="raw"), photo("W1", 1)], choice=LensChoice())
    assert mixed.notes == ("one is RAW, the other is not: their lens distortion differs",)


def test_photos_held_differently_are_noted() -> None:
    (pair,), _ = pair_photos([photo("T1", 0, hw=(40, 30)), photo("W1", 1, hw=(30, 40))], choice=LensChoice())
    assert pair.notes == ("one is upright, the other lies on its side",)


def test_no_photos() -> None:
    assert pair_photos([], choice=LensChoice()) == ((), ())
