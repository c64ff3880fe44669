"""Find the value in which the vehicle stored in a set differs from the vehicle file given."""

from dataclasses import replace

from split_cli.vehicle.parameters import Vehicle, vehicle_to_mapping

#: What to do where a set that is judged was trained with another vehicle file.
CHANGED_FILE_ADVICE = (
    "If you changed the vehicle file on purpose, train again with it. Without --vehicle the set is judged with its own."
)


def trained_for_another(trained: Vehicle, given: Vehicle) -> str:
    """Return what to say of a set that was trained for one vehicle and is asked for another."""
    same = f"of the same name, {given.name}"
    other = same if trained.name == given.name else f"({trained.name}) than {given.name}"
    return f"was trained for another vehicle {other}: {_differences(trained, given)}"


def _differences(trained: Vehicle, given: Vehicle) -> str:
    """Return where two vehicles differ first, in words, and in how many other places."""
    for digits in (6, 17):
        one, other = _physics(trained, digits), _physics(given, digits)
        names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
        if names:
            break
    else:
        return "the order or number of their effects differs"
    more = f", and {len(names) - 1} more" if len(names) > 1 else ""
    was, now = one.get(names[0], "absent"), other.get(names[0], "absent")
    return f"{names[0]} is {was} in the set and {now} in the file{more}"


def _physics(vehicle: Vehicle, digits: int) -> dict[str, str]:
    """Return every value of a vehicle in words, with so many digits, by its name in the file."""
    found = {}
    for key, value in vehicle_to_mapping(replace(vehicle, name="", origins={}, notes={})).items():
        if key == "effects":
            for effect in value:
                numbers = ", ".join(f"{name} {number:.{digits}g}" for name, number in effect["parameters"].items())
                found[effect["term"]] = " ".join(part for part in (effect.get("variant"), numbers) if part)
        elif isinstance(value, dict):
            found |= {f"{key}.{name}": f"{number:.{digits}g}" for name, number in value.items()}
        elif key != "name":
            found[key] = f"{value:.{digits}g}"
    return found
