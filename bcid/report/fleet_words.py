"""What the logs of a fleet say together, in sentences: which effect the cars have since when, and what moved."""

from collections.abc import Mapping, Sequence

from bcid.documents.fleet import PRESENT, FleetDiagnosis, FleetDocument, FleetEffect, FleetLog, MovedParameter
from bcid.report.budget_words import percent, percent_range
from bcid.report.formats import format_number, join_words, plain_name, symbol_text, unit_text


def fleet_sentences(document: FleetDocument) -> list[str]:
    """A sentence for each effect of the fleet and each later day, if two drives are known, and one for each copy."""
    together, copies = document.together, [_copy_sentence(log) for log in document.logs if log.same_drive_as]
    if together is None:
        return copies
    car_of = {log.name: log.car for log in document.logs if log.car}
    effects = [effect_sentence(effect, len(together.days) > 1, car_of) for effect in together.effects]
    return [
        *(effects or ["No effect is common to enough logs to be the fleet's."]),
        *day_sentences(together, {log.name: log.day for log in document.logs}),
        *copies,
    ]


def _copy_sentence(log: FleetLog) -> str:
    """That a log is of another one's drive, and what comes of it."""
    return f"{log.name} is the same drive as {log.same_drive_as}, at least in part: only that one is counted."


def effect_sentence(effect: FleetEffect, several_days: bool, car_of: Mapping[str, str]) -> str:
    """Which effect the fleet has, since when, in what share of the cars or logs, and in which of them.

    `car_of` gives the car of each log, of those of which it is known.
    """
    having = [name for name, p in effect.in_logs.items() if p > PRESENT]
    who, where = ("cars", _list_by_car(having, car_of)) if car_of else ("logs since then", having)
    name = plain_name(effect.effect)
    text = f"{name[0].upper()}{name[1:]}"
    if effect.twins:
        text += f", or {join_words([plain_name(twin) for twin in effect.twins], 'or')},"
    since = f" since {effect.since} (probability {format_number(effect.since_probability, 2)})" if several_days else ""
    share = f"{percent(effect.share)} of the {who} (90 % interval {percent_range(*effect.share_ci90)})"
    certain = "more than 0.999" if effect.probability > 0.999 else format_number(effect.probability, 3)
    return (
        f"{text} is there{since}, in {share}: {join_words(where) or 'no single log for certain'}. "
        f"Together the logs show it with probability {certain}."
    )


def _list_by_car(logs: Sequence[str], car_of: Mapping[str, str]) -> list[str]:
    """Cars with their logs among `logs`, as "red (monday and tuesday)"; a log of an unknown car by itself."""
    of_car = dict[str, list[str]]()
    for log in logs:
        of_car.setdefault(car_of.get(log, ""), []).append(log)
    alone = of_car.pop("", [])
    return [*(f"{car} ({join_words(own)})" for car, own in of_car.items()), *alone]


def day_sentences(together: FleetDiagnosis, day_of: Mapping[str, str]) -> list[str]:
    """For each later day what is otherwise there than on the first: "the cars of …, but for …".

    `day_of` gives the day of each log: an effect that has come is told of the days of which a log has it.
    """
    first, *later = together.days
    order = {day: k for k, day in enumerate(together.days)}
    sentences = []
    for day in later:
        moved = [m for m in together.moved if m.day == day]
        effects = [
            plain_name(e.effect) for e in together.effects
            if order[e.since] > 0 and any(p > PRESENT and day_of[name] == day for name, p in e.in_logs.items())
        ]  # fmt: skip
        changes = [change_in_words(m) + (f" beside {m.beside}" if m.beside != first else "") for m in moved]
        other = join_words([*effects, *changes])
        sentences.append(
            f"{day}: the cars of {first}, but for {other}." if other
            else f"{day}: no parameter is shown to be another than on {first}."
        )  # fmt: skip
    unknown = [f"{join_words(together.without)}: no log was diagnosed."] if together.without else []
    if together.left_out:
        named = join_words(together.left_out)
        unknown.append(
            f"Parameters are compared without {named}: an effect of the fleet that is there has no name there."
        )
    return [*sentences, *unknown]


def name_of_parameter(symbol: str) -> str:
    """What a parameter is called: its symbol, and of which effect it is where it is written as effect.symbol.

    >>> name_of_parameter("K_t"), name_of_parameter("motor_lag.tau")
    ('K_t', 'τ of motor lag')
    """
    effect, _, own = symbol.rpartition(".")
    return f"{symbol_text(own)} of {plain_name(effect)}" if effect else symbol_text(own)


def change_in_words(moved: MovedParameter) -> str:
    """By how much a parameter is another, with its interval: "K_t +8 % (6 to 10 %)"."""
    name = name_of_parameter(moved.symbol)
    if moved.relative:
        low, high = (format_number(100.0 * x, 2) for x in moved.interval)
        return f"{name} {_format_signed(100.0 * moved.change)} % ({low} to {high} %)"
    low, high = (format_number(x, 2) for x in moved.interval)
    unit = f" {unit_text(moved.unit)}".rstrip()
    return f"{name} {_format_signed(moved.change)}{unit} ({low} to {high}{unit})"


def _format_signed(value: float) -> str:
    """A number with its sign, whichever that is."""
    return f"{'+' if value > 0.0 else ''}{format_number(value, 2)}"
