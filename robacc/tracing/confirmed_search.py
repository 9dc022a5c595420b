"""Search for effects, and the findings that held-out poses confirm."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.diagnostics.moved_frames import MovedFrames, held_out_frames, moved_frames
from robacc.fitting.cross_validation import HoldOut
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.confirmation import reproduced, with_held_out_gain
from robacc.tracing.cross_validation import CrossValidation, Progress, cross_validate, fold_choices
from robacc.tracing.equal_votes import with_equal_votes
from robacc.tracing.loop import SearchResult, search
from robacc.tracing.refitting import SEARCH
from robacc.tracing.remaining_scatter import with_remaining_scatter, with_scatter_in_fits


@dataclass(frozen=True)
class ConfirmedSearch:
    """Findings that held-out poses confirm, before they are held against the structure of the remaining errors."""

    search_result: SearchResult
    validation: CrossValidation | None
    moved: MovedFrames | None
    """Motion of base or target between the poses of the search and the validation poses."""
    warnings: tuple[str, ...]


def confirmed_search(
    model: Model, data: Measurements, how: HoldOut, empirical: bool, progress: Progress
) -> ConfirmedSearch:
    """Search for effects, and return the findings that recur in the folds and lower the error of held-out poses."""
    first_search = search(
        model,
        data,
        SEARCH,
        empirical=empirical,
        progress=lambda count, n_findings: progress(_search_label(count, n_findings), 0, how.n_folds + 1),
    )
    first_search = with_scatter_in_fits(first_search, data)
    search_result, validation = _recurring(first_search, data, how, empirical, progress)
    moved = None if how.validation is None else moved_frames(first_search.declared, how.validation)
    frames = None if how.validation is None or moved is None else held_out_frames(first_search.declared, how.validation)
    with_gain, validation, withdrawn = with_held_out_gain(search_result, validation, data, how, frames)
    search_result = with_remaining_scatter(first_search, with_gain, data)
    if search_result.effects != with_gain.effects:
        validation = validated_again(search_result, validation, data, how)
    return ConfirmedSearch(search_result, validation, moved, withdrawn)


def _recurring(
    first_search: SearchResult, data: Measurements, how: HoldOut, empirical: bool, progress: Progress
) -> tuple[SearchResult, CrossValidation | None]:
    """Return the search with the findings that recur in the folds, and its held-out residuals."""
    choices = None if how.validation is not None else fold_choices(first_search, data, how, empirical, progress)
    choices = None if choices is None else with_equal_votes(choices, first_search, data)
    search_result = reproduced(first_search, choices, data)
    is_whole = search_result.effects == first_search.effects and bool(first_search.effects)
    validation = cross_validate(search_result, choices, data, how, is_whole=is_whole)
    if validation is None and choices is not None:
        # No fold can be fitted, so that no fold says anything about the findings either.
        return reproduced(first_search, None, data), None
    return search_result, validation


def validated_again(
    search_result: SearchResult, earlier: CrossValidation | None, data: Measurements, how: HoldOut
) -> CrossValidation | None:
    """Return the cross-validation of a search that lacks some findings of an earlier one."""
    return cross_validate(search_result, None if earlier is None else earlier.choices, data, how, earlier=earlier)


def _search_label(count: int, n_findings: int) -> str:
    """Return the label of the search's progress in round ``count``."""
    findings = f", {n_findings} finding{'s' * (n_findings != 1)}" if count > 1 else ""
    return f"searching, round {count}{findings}"
