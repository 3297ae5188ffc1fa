"""The commands that list what there is: `bcid models` and `bcid effects`."""

from typing import Annotated, Any

import typer

from bcid.cli import options
from bcid.cli.completion import complete_effects
from bcid.cli.options import Format


def list_models(format: options.FormatOption = Format.human) -> None:  # noqa: A002
    """List the models, with what each is and which command makes it."""
    from bcid.cli.sink import Sink, plain_table
    from bcid.models.table import MODELS

    rows: list[dict[str, Any]] = [
        {
            "model": name, "summary": row.summary, "base": row.base, "defaults": dict(row.defaults),
            "made_by": row.made_by or "bcid fit",
        }
        for name, row in MODELS.items()
    ]  # fmt: skip
    shown = [[row[key] for key in ("model", "summary", "made_by")] for row in rows]
    Sink(format).result(
        {"schema": "bcid.models/1", "models": rows},
        lambda: plain_table("models", ["name", "what it is", "made by"], shown),
    )


def list_effects(
    name: Annotated[
        str | None,
        typer.Argument(help="The id of one effect to look up. Default: list all.", autocompletion=complete_effects),
    ] = None,
    effects: options.EffectsOption = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Write the page docs/effects.md to stdout.")] = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """List the effects (terms of physics beyond the base model) that a diagnosis can name, or look up one of them.

    With --effects FILE those of the file are checked and listed.
    """
    from bcid.cli.sink import Sink, plain_table
    from bcid.effects.listing import describe_effect, effect_json, effects_page
    from bcid.effects.table import EFFECTS, find_effect

    built_in = set(EFFECTS)
    with options.own_effects(effects):
        chosen = [find_effect(name)] if name else [e for e in EFFECTS.values() if not effects or e.id not in built_in]

    def human() -> Any:
        if markdown:
            return effects_page(chosen)
        if name:
            return describe_effect(chosen[0])
        return plain_table("effects", ["id", "equation", "channel"], [[e.id, e.equation, e.channel] for e in chosen])

    sink = Sink(format)
    if effects:
        sink.note(f"{effects}: as effects must be (finite, nothing where off, right units, compiled)")
    sink.result({"schema": "bcid.effects/1", "effects": [effect_json(e) for e in chosen]}, human)
