"""Terms and simulated effects as a page, generated from them: ``python -m split_cli.cli.catalogue``."""

import inspect

import click


def catalogue_page() -> str:
    """Return docs/catalogue.md: every term with its physics and what mimics it, then the effects."""
    from split_cli.vehicle.effects import CATALOGUE
    from split_cli.workflows.simulate import effect_kinds

    parts = [
        "# The catalogue",
        "",
        "This page is a reference for readers of a diagnosis. It lists the *terms*: physical effects and sensor",
        "faults that `split diagnose` can name, and that `effects:` in a [vehicle file](formats.md#vehicle-yaml)",
        "can hold. Only `feature_lag` is never named; training uses it. A parameter is the difference of the real",
        "car from the nominal model. At its neutral value, in brackets in the table, the term has no",
        "effect. A *variant* is another form of the term; the diagnosis tries all. Frames, signs and symbols are",
        "those of the [nomenclature](nomenclature.md).",
        "",
        "`python -m split_cli.cli.catalogue > docs/catalogue.md` generates this page; a test compares both.",
        "",
        "| term | effect of the real car | parameters (neutral) |",
        "|---|---|---|",
    ]
    for name, kind in CATALOGUE.items():
        first = _paragraphs(kind)[0].split(": ")[0].split("; ")[0].split(". ")[0].rstrip(".")
        parts.append(f"| [`{name}`](#{name}) | {first} | {_parameters(kind, kind.variants[0])} |")
    for name, kind in CATALOGUE.items():
        parts += ["", f"## {name}", ""]
        for paragraph in _paragraphs(kind):
            parts += [paragraph, ""]
        parts += _facts(kind)
    parts += [
        "",
        "## Effects of the simulated cars",
        "",
        "`split simulate --effect NAME:parameter=value,...` adds these effects to the physics of the simulated",
        "double-track car. The driver does not know them. Several effects of one actuator act in a fixed order.",
        "Places (`s_start`, `s_end`) are distances along the track's centreline.",
        "",
        "| effect | change of the car | range of the parameters |",
        "|---|---|---|",
    ]
    for name, effect in effect_kinds().items():
        ranges = ", ".join(
            f"`{parameter}` {limits.lower:g} to {limits.upper:g} {limits.unit}".rstrip()
            + ("" if limits.default is None else f" (default {limits.default:g})")
            for parameter, limits in effect.parameters.items()
        )
        parts.append(f"| `{name}` | {effect.about} | {ranges} |")
    return "\n".join(parts).rstrip() + "\n"


def _paragraphs(kind: type) -> list[str]:
    text = inspect.getdoc(kind).replace("``", "`")
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n")]


def _parameters(kind: type, variant: str) -> str:
    def shown(name: str, unit: str) -> str:
        neutral = f" ({kind.neutral[name]:g})" if name in kind.neutral else ""
        return f"`{name}` [{unit}]{neutral}"

    return ", ".join(shown(name, unit) for name, unit in kind.parameter_units(variant).items())


def _facts(kind: type) -> list[str]:
    lines = [f"- Parameters: {_parameters(kind, kind.variants[0])}"]
    for variant in kind.variants[1:]:
        own = _parameters(kind, variant)
        same = own == _parameters(kind, kind.variants[0])
        lines.append(f"- Variant `{variant}`, {kind.variant_words[variant]}" + ("" if same else f": {own}"))
    if kind.states:
        lines.append(f"- States it adds to the model: {', '.join(f'`{kind.id}.{name}`' for name in kind.states)}")
    if not kind.exported:
        lines.append(
            "- This is a fault of the measurement. It is never written into a vehicle file and never exported."
        )
    for mimic in kind.mimics:
        terms = " and ".join(f"`{term}`" for term in mimic.terms.split("+"))
        how = "No drive separates it from" if mimic.exact else "Looks like"
        together = " together" if "+" in mimic.terms else ""
        case = f"Reason: {mimic.when}." if mimic.exact else f"Case: {mimic.when}."
        apart = f" Separated by: {mimic.separated_by}." if mimic.separated_by else ""
        lines.append(f"- {how} {terms}{together}. {case}{apart}")
    return lines


if __name__ == "__main__":
    click.echo(catalogue_page(), nl=False)
