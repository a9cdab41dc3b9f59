"""Effects of the air: drag, wind, inflow and surfaces nearby."""

from inclined_landing.models.effects.effect import Effect, Parameter


def _ground_effect(vehicle, values):
    strength = values.get("strength", 0.0)
    if strength == 0.0:
        return vehicle
    present, before = vehicle.effects_ground_effect, vehicle.effects_ground_fading
    fading = values.get("fading", before)
    # Laws that fade differently do not add up to one such law: take the mean fading, weighted by strength.
    if present != 0.0:
        fading = (abs(present) * before + abs(strength) * fading) / (abs(present) + abs(strength))
    return vehicle.changed(effects_ground_effect=present + strength, effects_ground_fading=fading)


def _drag(name: str, parts: tuple[int, ...]) -> Parameter:
    return Parameter(
        name,
        neutral=1.0,
        bounds=(0.0, 10.0),
        plausible=2.0,
        negligible=0.1,
        fields=tuple(f"drag_coefficients.{k}" for k in parts),
        reported=f"rotor drag, {name}",
        share=True,
    )


EFFECTS = (
    Effect(
        name="rotor_drag",
        description="The rotors' drag, proportional to rotor speed and air speed, is stronger or weaker than "
        "modelled. Across the rotors it comes from flapping blades and their own drag, along their axis "
        "from the inflow; hence the two coefficients.",
        formula="F_a = diag(lateral, lateral, axial) diag(drag) w_sum v_body",
        source="Foerster 2015; fitted flights of similar vehicles show 1.3 to 1.6 times as much, with "
        "guards or markers in the flow several times",
        parameters=(_drag("lateral", (0, 1)), _drag("axial", (2,))),
        regimes=("lateral", "climb"),
        confused_with=("body_drag", "wind", "translational_lift", "axial_inflow"),
        remedy="Accept the corrected coefficients; a flight at high speed distinguishes it from quadratic "
        "body drag.",
        channels=("translation",),
        says="the rotors have {lateral} times the modelled drag across their axes, {axial} times along them",
    ),
    Effect(
        name="body_drag",
        description="Drag of body, decks and markers, growing with the square of the air speed.",
        formula="F_a += -coefficient |v_air| v_air",
        source="drag of a blunt body: half of air density, drag coefficient and area; 0.006 kg/m for 0.01 m2",
        parameters=(
            Parameter(
                "coefficient",
                unit="kg/m",
                bounds=(0.0, 0.08),
                plausible=0.006,
                negligible=0.001,
                one_signed=True,
            ),
        ),
        regimes=("lateral", "climb"),
        confused_with=("rotor_drag", "wind"),
        remedy="Remove parts that stand in the flow, or accept the term. A slow and a fast flight along the "
        "same path distinguish it from rotor drag.",
        channels=("translation",),
        says="the body has a quadratic drag of {coefficient}",
    ),
    Effect(
        name="wind",
        description="The air moves over the ground with a constant horizontal velocity, for example from "
        "ventilation, an open door or the wake of other vehicles. All drag depends on the velocity relative "
        "to the air.",
        formula="v_air = v - (x, y, 0)",
        source="definition",
        parameters=(
            Parameter("x", unit="m/s", bounds=(-20.0, 20.0), plausible=1.0, negligible=0.05),
            Parameter("y", unit="m/s", bounds=(-20.0, 20.0), plausible=-0.6, negligible=0.05),
        ),
        regimes=("hover", "lateral", "climb"),
        confused_with=("attitude_trim", "com_offset"),
        remedy="Switch off the ventilation and close the doors. Hovering at two headings a quarter turn "
        "apart distinguishes it from a trim, which turns with the vehicle.",
        channels=("translation",),
        says="the air moves with {x} along x and {y} along y",
        of_the_place=True,
    ),
    Effect(
        name="translational_lift",
        description="In forward flight the rotors meet undisturbed air and give more thrust.",
        formula="F_t times (1 + coefficient v_plane^2), v_plane the air speed in the rotor plane",
        source="momentum theory: about 1/(2 v_h^2) with the induced velocity in hover v_h = 4.4 m/s",
        parameters=(
            Parameter("coefficient", unit="s2/m2", bounds=(-0.05, 0.15), plausible=0.025, negligible=0.002),
        ),
        regimes=("lateral",),
        confused_with=("rotor_drag", "body_drag", "axial_inflow"),
        remedy="Expect a climb in fast flight, and command less thrust there.",
        channels=("translation",),
        says="fast flight through the air adds thrust ({coefficient})",
    ),
    Effect(
        name="axial_inflow",
        description="The rotors give less thrust in a climb and more in a descent, which damps vertical "
        "motion.",
        formula="F_t times max(0, 1 - coefficient v_axial), v_axial the air speed along body z",
        source="blade element theory: inflow reduces the blades' angle of attack",
        parameters=(
            Parameter("coefficient", unit="s/m", bounds=(-0.1, 0.4), plausible=0.05, negligible=0.008),
        ),
        regimes=("climb", "hover"),
        confused_with=("rotor_drag", "motor_lag", "translational_lift"),
        remedy="Command more thrust in climbs and less in descents than the hover thrust suggests.",
        channels=("translation",),
        says="thrust decreases in climbs and increases in descents ({coefficient})",
    ),
    Effect(
        name="ground_effect",
        description="Near a surface each rotor gives more thrust, depending on its own distance along the "
        "surface's normal. Near a slope the uphill rotors gain more, which turns the vehicle away from it. "
        "A disc partly over the slab's edge gains its share there, the rest from the floor. The fading is "
        "the inverse range of an exponential decay on top of the law; the strength refers to four radii.",
        formula="F_i times (1 + strength (r/(4 h_i))^2 exp((4 r - h_i) fading)), r/(4 h_i) at most 1/2",
        source="Cheeseman and Bennett 1955 (strength 1, one rotor, no fading); several times that with four, "
        "Sanchez-Cuevas et al. 2017; an exponential end, He et al. 2019; 4 to 9 % below 7 cm in the "
        "nanobench flights",
        parameters=(
            Parameter(
                "strength",
                bounds=(-2.0, 40.0),
                plausible=5.0,
                negligible=0.5,
                one_signed=True,
                fields=("effects_ground_effect",),
            ),
            Parameter(
                "fading", unit="1/m", bounds=(0.0, 40.0), plausible=3.0, negligible=2.5, is_reference=True
            ),
        ),
        regimes=("near_surface", "touchdown"),
        confused_with=("thrust_scale", "thrust_bias", "platform_height"),
        remedy="Reduce the thrust during the last 10 cm, or approach faster. Flights near to and far from "
        "surfaces distinguish it from a thrust scale.",
        channels=("translation", "attitude"),
        apply=_ground_effect,
        says="near a surface the rotors give more thrust (strength {strength})",
    ),
)
