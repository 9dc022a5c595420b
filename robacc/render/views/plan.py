"""A plan of a measurement: route, feasible poses, what to expect of the fit or a trace; and the comments of its CSV."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.planning.campaign import DEFAULT_FIT, CampaignPlan
from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, effect_label, fixed, table_unit, three_digits
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Text,
    Tile,
    amount,
    effect_families,
    number,
    of_robot,
)

PURPOSES = {
    "calibrate": "calibration",
    "trace": "trace of causes",
    "acceptance": "acceptance",
    "health": "health check",
}
_LISTED_PAIRS = {"full": 8, "page": 20}
_MORE = "`full=True` adds the route, excluded poses, other numbers of poses, standard errors and detection limits"
_FINDS_MOST = 0.5
"""Mean probability from which more effects of the usual size are found than missed."""
_COMMANDS = {
    "calibrate": ("calibrate", "--fit"),
    "trace": ("trace", "--declared"),
    "acceptance": ("estimate", "--gate"),
    "health": ("calibrate", "--fit"),
}
"""What evaluates the measured poses, by purpose, and its option for what was planned for."""
_VISITS = 200
"""Visits that the page lists."""

Part = Mapping[str, Any]


def plan_comments(plan: CampaignPlan) -> list[str]:
    """Return the comment lines above the columns of the visits."""
    comments = [
        f"Planned by robacc plan for {PURPOSES[plan.settings.purpose]} of {plan.robot.name}: "
        f"{plan.chosen.size} poses, {len(plan.route.roles)} visits in this order; nothing was measured.",
        "Drive straight from row to row, and add x, y, z (and orientation) as measured; dir_ and speed_ are those of "
        "the moves from row to row.",
        "Check every pose for collisions before you send it.",
    ]
    if plan.payload_blocks:
        blocks = [(block.payload, block.first, block.n_visits, block.n_poses) for block in plan.payload_blocks]
        comments.insert(1, f"Payloads, each mounted once: {_payloads(blocks, plan.settings.payloads)}.")
    return comments


def plan_headline(document: Document) -> ReportHeadline:
    """Return the number of poses and visits, the predicted error, and whether earlier poses are enough."""
    accuracy, sufficiency, noise = document["accuracy"], document["sufficiency"], document["noise"]
    n, visits, power = document["n_poses"], document["n_visits"], document["power"]
    summary = f"{n} poses in {visits} visits, chosen from {document['candidates']['feasible']} feasible poses."
    tiles = [Tile("different poses", Number(str(n), float(n))), Tile("visits", Number(str(visits), float(visits)))]
    if accuracy is not None and (planned := accuracy["planned"]) is not None:
        tiles.append(Tile("predicted error after the fit, rms", amount(planned["rms_m"])))
        tiles.append(Tile("the same of random poses", amount(planned["random_rms_m"])))
    if power is not None:
        tiles += [
            Tile(
                label,
                Number(f"{100 * power[key]:.0f} %", power[key]),
                f"random poses {100 * power[f'random_{key}']:.0f} %",
            )
            for label, key in (("effects found at their usual size", "found"), ("found and separated", "separated"))
        ]
    badges = []
    if sufficiency is not None:
        summary += f" After {sufficiency['n_already']} poses: {sufficiency['why']}."
        badges = [("enough poses", "good") if sufficiency["enough"] else ("more poses needed", "open")]
    facts = [
        ("Instrument", f"{amount(noise['position_m'])} along each axis"),
        ("Repeatability", f"{amount(noise['repeatability_m'])} along each axis at the target"),
        ("Source of the noise", str(noise["source"])),
        *([("Free effects", ", ".join(document["fit"].split(",")))] if document["fit"] else []),
    ]
    title = f"Plan for the {PURPOSES[document['purpose']]}{of_robot(document)}"
    return ReportHeadline(title, summary, tiles, badges, facts)


def plan_view(document: Document, form: Form = "page", robot: str = "", output: str | None = None) -> Iterator[Section]:
    """Return whether the poses are enough, what excluded candidates, and what to expect, in short or in full.

    ``robot`` is the name of the robot's file, ``output`` that of the CSV if it was written.
    """
    name, purpose = document["robot"]["name"], PURPOSES[document["purpose"]]
    count = f"{document['n_poses']} poses, {document['n_visits']} visits"
    title = "Order of the visits" if form == "page" else f"Plan for the {purpose} of {name}: {count}"
    yield Section(title, [Listing([*_facts(document, form != "short")])])
    if (sufficiency := document["sufficiency"]) is not None:
        verdict = "Enough" if sufficiency["enough"] else f"Not enough: measure the next {document['n_poses']}"
        yield Section(verdict, [Listing([*_sufficiency(sufficiency)])])
    excluded = [(each["reason"], str(each["count"]), str(each["alone"])) for each in document["candidates"]["excluded"]]
    if form != "short":
        yield Section("Feasible poses", [Grid(("candidates excluded by", "count", "by this alone"), excluded)])
    if document["needed_poses"]:
        yield _needed(document["needed_poses"])
    if document["accuracy"] is not None:
        options = document.get("options", {})
        region = "the task" if options.get("task") or options.get("region") else "all poses of the arm"
        yield Section(f"Predicted error after the fit, over {region}, mm", _accuracy(document, form != "short"))
    if form == "short":
        found = [] if document["power"] is None else [*_found(document["power"])]
        ahead = Text(f"next: {_next_step(document, robot, output)}")
        yield Section("", [Listing(found), Text(_MORE, is_note=True), ahead])
        return
    most = _LISTED_PAIRS[form]
    if document["purpose"] in ("calibrate", "health"):
        yield _coefficients(document["coefficients"])
    if document["correlations"] and document["purpose"] == "calibrate":
        pairs = [f"{pair['first']} and {pair['second']} ({pair['value']:+.2f})" for pair in document["correlations"]]
        yield Section("Estimates that stay strongly correlated", [Listing(pairs[:most])])
    if document["detection_limits"] is not None:
        yield Section("Effects that a trace of these poses can find", _detectability(document, most))
    texts = _pairs(document["inseparable"] or ())
    more = Text(f"… and {len(texts) - most} more pairs" * (len(texts) > most), is_note=True)
    yield Section("Pairs that are not distinguishable at the usual size", [Listing(texts[:most]), more])
    if form == "page":
        yield _visits(document)


def _next_step(document: Document, robot: str, output: str | None) -> str:
    """Return what to do with the plan."""
    purpose, options = document["purpose"], document.get("options", {})
    name, option = _COMMANDS[purpose]
    planned_for = options.get("gate") if purpose == "acceptance" else document["fit"]
    planned_for = planned_for or DEFAULT_FIT["health"] * (purpose == "health")
    file = output or "PLAN"
    start, rows = "" if output else "write the poses (`output=PLAN`), ", "add the columns x, y, z as measured"
    start += f"measure {'them' if start else 'the poses'} in the order of {file}"
    if document["sufficiency"] is not None:
        file, rows = "ALL", f"{rows}, put the rows of all batches into one file ALL"
    command = f"robacc {name} {file} --robot {robot}" + f" {option} {planned_for}" * bool(planned_for)
    return f"{start}, {rows}, then: {command}"


def _sufficiency(sufficiency: Part) -> Iterator[str]:
    yield sufficiency["why"]
    if None not in (sufficiency["now_m"], sufficiency["later_m"]):
        now, later = (three_digits(sufficiency[key] * IN_MM) for key in ("now_m", "later_m"))
        yield f"error to expect: {now} mm rms now, {later} mm with the next poses"
    counted, new = (
        ("poses of the model's fit", "poses") if sufficiency["of_model"] else ("rows measured already", "rows")
    )
    yield f"this counts the {sufficiency['n_already']} {counted}: fit them together with the new {new}"


def _facts(document: Document, full: bool) -> Iterator[str]:
    """Yield where the poses come from, how often each is visited, and what was assumed; with ``full`` the route too."""
    route, noise, candidates = document["route"], document["noise"], document["candidates"]
    blocks = [
        (block["payload_kg"], block["first_visit"], block["n_visits"], block["n_poses"])
        for block in document["payloads"]
    ]
    with_each = " with each payload" if len(blocks) > 1 else ""
    yield f"chosen from {candidates['feasible']} feasible poses of {candidates['source']}{with_each}"
    repeats, n_poses, n_visits = route["repeats"], document["n_poses"], document["n_visits"]
    again = f", {repeats} of them a second time" if repeats else ""
    checks = n_visits - n_poses - repeats
    check = f", one of them{with_each} {checks} more time{'s' * (checks > 1)} to show drift" if checks else ""
    yield f"{n_visits} visits: each of the {n_poses} poses once{again}{check}"
    turn = noise["orientation_rad"]
    orientation = "" if turn is None else f", {turn * IN_DEGREES:.3g}° about each axis"
    ask = "; `noise` and `repeatability` state yours" if "typical" in noise["source"] else ""
    yield (
        f"instrument {three_digits(noise['position_m'] * IN_MM)} mm and repeatability "
        f"{three_digits(noise['repeatability_m'] * IN_MM)} mm along each axis{orientation} ({noise['source']}{ask})"
    )
    if full:
        least, passes = min([*route["rarer_direction_share"]], default=0.0), route["passes"]
        yield (
            f"route: {passes} pass{'es' * (passes > 1)} through the poses; its moves add up to {route['length']:.1f} "
            f"times the range of a joint ({route['random_length']:.1f} in a random order); each joint is approached "
            f"from its rarer direction in at least {100 * least:.0f} % of its moves"
        )
    yield _collisions(document["collisions"])
    if blocks:
        yield f"payloads: {_payloads(blocks, document.get('options', {}).get('payload') or ())}"
    if document["validation"] is not None:
        yield f"{len(document['validation']['q'])} more poses for validation only"
    worth = document["worth"]
    if full and worth is not None and worth["new_poses_rms_m"] is not None:
        yield f"if there is time for twice the measurements: {worth['verdict']}"


def _collisions(collisions: Part | None) -> str:
    """Return what was checked for collisions."""
    if collisions is None:
        return "collisions of the links not checked: check every pose before you send it"
    checked = f"{len(collisions['pairs'])} pairs of links checked for collisions, without tool, payload and cables"
    if not collisions["overlapping"]:
        return checked
    pairs = ", ".join(" and ".join(pair) for pair in collisions["overlapping"])
    return f"{checked}; not checked, as they touch at nearly all poses: {pairs}"


def _payloads(blocks: Sequence[tuple[float, int, int, int]], payloads: Sequence[float]) -> str:
    """Return ``0 kg (visits 1 to 18, 15 poses), 5 kg (…)``, and the payloads that no pose has."""
    used = {payload for payload, *_ in blocks}
    texts = [
        f"{payload:g} kg (visits {first} to {first + n_visits - 1}, {n_poses} poses)"
        for payload, first, n_visits, n_poses in blocks
    ]
    return ", ".join([*texts, *(f"none with {payload:g} kg" for payload in payloads if payload not in used)])


def _needed(entries: Sequence[Part]) -> Section:
    header = ("limit", "mm", *(f"{100 * each['true_over_limit']:.0f} %" for each in entries[0]["by_ratio"]))
    rows: list[Sequence[Cell]] = [
        (
            f"{entry['name']} ({entry['statistic']})",
            number(entry["limit_m"], IN_MM),
            *("–" if each["n_poses"] is None else str(each["n_poses"]) for each in entry["by_ratio"]),
        )
        for entry in entries
    ]
    texts = [
        f"planned for {entry['name']}: {entry['n_poses'] or 'too many'} poses, for a true value of "
        f"{100 * entry['true_over_limit']:.2g} % of the limit"
        for entry in entries
    ]
    texts.append("the nearer the true value to the limit, the more poses; `expected` states the value that you expect")
    title = "Poses to decide with a probability of 90 %, by true value in % of the limit"
    return Section(title, [Grid(header, rows), Listing(texts)])


def _accuracy(document: Document, is_curve: bool) -> Iterator[Block]:
    """Yield the error over the number of poses, or near the planned number; they are added to earlier ones if any."""
    accuracy, is_addition = document["accuracy"], document["sufficiency"] is not None
    planned, knee = accuracy["planned"], accuracy["knee"]
    enough = next((p["n_poses"] for p in accuracy["curve"] if knee is not None and p["n_poses"] >= knee), None)
    rows: list[Sequence[Cell]] = []
    for point in accuracy["curve"]:
        n = point["n_poses"]
        marks = [
            *(["planned"] if planned is not None and n == planned["n_poses"] else []),
            *(["enough"] if n == enough and not is_addition else []),
        ]
        values = (number(point[f"{key}_m"], IN_MM) for key in ("total_rms", "rms", "worst", "random_rms"))
        if is_curve or marks:
            rows.append((str(n), *values, ", ".join(marks)))
    first = "more poses" if is_addition else "poses"
    yield Grid((first, "to expect, rms", "model, rms", "model, worst", "model, random", "remark"), rows)
    if planned is None:
        advice = ["the planned poses do not identify all coefficients; plan more poses or fit less"]
    elif enough is None:
        advice = ["more poses are worth it: ten more still reduce the error to expect by more than 10 %"]
    else:
        spare = planned["n_poses"] - enough
        advice = [
            f"{enough} poses are enough (`poses={enough}`): ten more reduce the error to expect by less than 10 %"
            + f"; if there is time, the other {spare} are a reserve for failed measurements and for checking the fit"
            * (spare > 0)
        ]
    meaning = (
        "to expect: error of the arm with the fitted model, repeatability included; model: without repeatability, also "
        "at its worst pose and fitted to random poses"
    )
    yield Listing([meaning] if is_addition and planned is not None else [meaning, *advice])


def _coefficients(entries: Sequence[Part]) -> Section:
    rows = [
        (entry["name"], number(entry["std"], factor), unit)
        for entry in entries
        if entry["std"] is not None
        for factor, unit in [table_unit(entry["unit"])]
    ]
    missing = ", ".join(entry["name"] for entry in entries if entry["std"] is None)
    note = Text(f"not identifiable: {missing}" * bool(missing), is_note=True)
    return Section("Predicted standard errors", [Grid(("coefficient", "standard error", "unit"), rows), note])


def _detectability(document: Document, most: int) -> Iterator[Block]:
    families = effect_families(document)
    rows = []
    for family in (each for each in families if each.known):
        first, last = family.known[0], family.known[-1]
        factor, unit = table_unit(first["unit"])
        sizes = (first["limit"], last["limit"], first["usual_size"])
        lowest, highest, usual = (f"{factor * size:.1e}" for size in sizes)
        rows.append((family.name, lowest, highest * (first is not last), unit, usual, fixed(family.power, 2)))
    hidden = dict.fromkeys(
        effect_label(family.name, each["joints"], {})
        for family in families
        for each in family.entries
        if each["limit"] is None and each["joints"] not in [limit["joints"] for limit in family.known]
    )
    yield Grid(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows)
    notes: list[str] = []
    if (power := document["power"]) is not None:
        notes += _found(power)
    notes.append("limit: size found with probability 1/2; power: probability that the usual size is found")
    if hidden:
        more = f" and {len(hidden) - most} more" if len(hidden) > most else ""
        notes.append(f"never found on these poses: {', '.join([*hidden][:most])}{more}")
    untested = document["not_testable"] or {}
    by_reason = {reason: [name for name in untested if untested[name] == reason] for reason in untested.values()}
    yield Listing([*notes, *(f"not tested ({reason}): {', '.join(names)}" for reason, names in by_reason.items())])


def _found(power: Part) -> Iterator[str]:
    """Yield the probability that a trace of the poses finds an effect, and whether that is good."""
    found, random_found, separated, random_separated = (
        f"{100 * power[key]:.0f} %" for key in ("found", "random_found", "separated", "random_separated")
    )
    yield (
        f"a trace of these poses finds a cause of its usual size with probability {found} on average (random poses: "
        f"{random_found}), and distinguishes it from the most similar cause with {separated} ({random_separated})"
    )
    yield (
        "this is good: more causes of their usual size are found than missed"
        if power["found"] >= _FINDS_MOST
        else "this is low: most causes are found only if they are larger than usual; a better instrument "
        "(`noise` states it) raises it, more poses (`poses`) a little"
    )


def _pairs(pairs: Sequence[Part]) -> list[str]:
    """Return a text for each pair; a pair that is inseparable both ways has one."""
    ways = {(pair["first"], pair["second"]) for pair in pairs}
    return [
        f"{first} and {second} explain each other {similarity}"
        if (second, first) in ways
        else f"{second} explains {first} {similarity}"
        for first, second, similarity in (
            (p["first"], p["second"], f"(similarity {p['similarity']:.2f})") for p in pairs
        )
        if (second, first) not in ways or first < second
    ]


def _visits(document: Document) -> Section:
    visits, joints = document["visits"], document["robot"]["joints"]
    units = [table_unit("rad" if joint["type"] == "revolute" else "m") for joint in joints]
    payloads = [] if visits["payload_kg"] is None else ["payload, kg"]
    rows = [
        (
            str(i + 1),
            visits["pose"][i],
            visits["role"][i],
            *(f"{visits['payload_kg'][i]:g}" for _ in payloads),
            *(f"{value * factor:.{2 if unit == '°' else 1}f}" for value, (factor, unit) in zip(q, units, strict=True)),
        )
        for i, q in enumerate(visits["q"][:_VISITS])
    ]
    names = [f"{joint['name']}, {unit}" for joint, (_, unit) in zip(joints, units, strict=True)]
    more = f"The first {_VISITS} of {len(visits['q'])} visits; the CSV has all of them." * (len(visits["q"]) > _VISITS)
    return Section("Visits", [Grid(("visit", "pose", "role", *payloads, *names), rows), Text(more)])
