"""What the scout has found, made true: the family's past as it would be, had it had his names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tomthumb.branches import Branch, followed, merged_into, renamed
from tomthumb.lifecycle import Ledger, copy_ledger, inherit
from tomthumb.retrace import retraced
from tomthumb.scout import Found, Scout, lately, names_of
from tomthumb.types import Ids, Mask

if TYPE_CHECKING:
    from tomthumb.slam import Slam


def put_right(scout: Scout, slam: Slam, found: Found) -> Branch:
    """The family's branch as it would be, had it had the scout's names; its landmarks younger than them are his now.

    He is judged by his own names only: of the family's, some were given from a wrong pose. Raises Diverged if the filter
    does not survive his.
    """
    home, since = slam.branches[0], found.since
    before = merged_into(home)
    into = followed(before | found.same)
    mine = {i for i, life in scout.branch.ledger.items() if life.born > since} | set(found.named)
    ours = names_of(home, len(scout.diary.entries))
    names = [_once(renamed(ids, into), ~np.isin(ids, list(into))) for ids in ours]
    claimed = [np.isin(renamed(ids, before), list(found.same)) for ids in ours]
    for k, (ids, _) in enumerate(lately(scout, since)):
        his = np.isin(ids, list(mine))
        names[k] = _once(np.where(his, renamed(renamed(ids, found.named), into), names[k]), his)
        claimed[k] = his
    old = {i: life for i, life in home.ledger.items() if life.born <= since}
    lives = copy_ledger({i: life for i, life in old.items() if i not in home.crumbs or life.believed})
    for drop in found.same:
        if drop in lives and into[drop] in lives:
            inherit(lives, into[drop], drop)
    _count(lives, [renamed(ids, into) for ids in ours], names, _scans(scout, slam.scan))
    fresh = copy_ledger({i: scout.branch.ledger[i] for i in mine - scout.branch.crumbs - set(found.named)})
    return retraced(slam, scout.diary, names[::-1], fresh | lives, scout.rules.tear, claimed[::-1])


def _once(ids: Ids, first: Mask) -> Ids:
    """Names (m,) of one scan with no landmark named twice: those of `first` (m,) count before others, and one of each."""
    out = ids.copy()
    order = np.argsort(~first, kind="stable")
    taken = np.unique(ids[order], return_index=True)[1]
    out[np.setdiff1d(order, order[taken])] = -1
    return out


def _count(lives: Ledger, before: list[Ids], after: list[Ids], scans: list[int]) -> None:
    """Sightings that have another name now count for that one. Entries are newest first, each with its scan.

    What was expected in vain was expected from the wrong pose: it is forgotten of those that were seen since.
    """
    for old, new, scan in zip(before, after, scans, strict=True):
        other = old != new
        for i in set(new[other].tolist()) & lives.keys():
            life = lives[i]
            life.hits, life.chances, life.static = life.hits + 1.0, life.chances + 1.0, life.static + 1
            if scan >= life.seen:
                life.seen, life.silence = scan, 0.0
        for i in set(old[other].tolist()) & lives.keys():
            lives[i].hits, lives[i].static = max(lives[i].hits - 1.0, 1.0), max(lives[i].static - 1, 1)


def _scans(scout: Scout, now: int) -> list[int]:
    """The number of each entry's scan, or of the last one before it, newest first."""
    taken = np.array([entry.scan is not None for entry in scout.diary.entries], np.int64)[::-1]
    return [int(n) for n in now - np.cumsum(taken) + taken]
