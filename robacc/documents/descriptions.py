"""Keys of ``robacc show``, of its forms ``robots`` and ``effects``, and of ``simulate``."""

from hashlib import sha256

from robacc.documents.keys import (
    OUTSIDE_KEY,
    Key,
    array,
    choice,
    count,
    digest,
    flag,
    number,
    ordinal,
    part,
    parts,
    size,
    table,
    text,
    vector3,
)
from robacc.effects.specification import coefficients

FRAME = part(xyz_m=Key(vector3, "Translation, m."), rpy_rad=Key(vector3, "Angles roll, pitch, yaw, rad.")).named(
    "frame", "Fixed transform T(xyz) Rz(yaw) Ry(pitch) Rx(roll)."
)

_MIMIC = part(
    joint=Key(text, "Name of the joint.", "master"),
    multiplier=Key(number, "Multiplier of the other joint's variable."),
    offset=Key(number, "Offset, rad or m."),
)
ROBOTS = part(
    robots=Key(
        parts(
            name=Key(text, "Name that the parameter robot takes."),
            maker=Key(text, "Maker of the arm."),
            model=Key(text, "The maker's name of the arm."),
            n_axes=Key(ordinal, "Number of joint variables."),
            reach_m=Key(size, "Reach as the maker states it, or computed where the source says so, m."),
            source=Key(text, "Source of the geometry."),
        ),
        "Arms by maker and name.",
    )
).named(about="Arms that come with the package.")

SHOW = part(
    robot=Key(
        part(
            name=Key(text, "Name in the file."),
            convention=Key(choice("standard", "modified", "urdf"), "Convention of the parameters."),
            base_link=Key(text | None, "Base link of a URDF."),
            tip_link=Key(text | None, "Tip link of a URDF."),
            gravity_m_s2=Key(vector3, "Gravity in the measuring frame, m/s².", "gravity"),
            base=Key(FRAME, "Transform from the measuring frame to the base."),
            tool=Key(
                FRAME | None,
                "Transform from the last link's frame to the target; null if there are several targets.",
                lambda robot: None if robot.targets else robot.tool,
            ),
            targets=Key(table(FRAME), "Several targets by name."),
            payload_com_m=Key(
                vector3 | None,
                "Centre of mass of the payload in the last link's frame, m; null: at the tool.",
                "payload_com",
            ),
            effects=Key(array(table()), "Effects of the file."),
            fitted_to=Key(
                array(text), "SHA-256 of each file of poses that the robot file was fitted to.", optional=True
            ),
            campaign=Key(
                part(
                    poses=Key(array(text), "SHA-256 of each file of its poses."),
                    frames=Key(
                        array(text),
                        "Frames that were registered in it.",
                        lambda campaign: [
                            name
                            for name, frame in {
                                "base": campaign.base,
                                "tool": campaign.tool,
                                **campaign.targets,
                            }.items()
                            if frame is not None
                        ],
                    ),
                    effects=Key(array(table()), "Effects that hold for its poses alone."),
                )
                | None,
                "Facts of the campaign that the model was fitted in; null without one.",
                optional=True,
            ),
            coefficients=Key(
                parts(
                    name=Key(text, "effect.joint.term."),
                    value=Key(number, "Value in the unit."),
                    unit=Key(text, "SI unit."),
                ),
                "Coefficients of the effects in the file, SI units.",
                lambda robot: [
                    {"name": name, "value": value, "unit": unit} for name, value, unit in coefficients(robot)
                ],
                optional=True,
            ),
        ),
        "Data of the complete arm.",
        "",
    ),
    n_joints=Key(count, "Number of joints with a variable.", lambda robot: len(robot.variables)),
    joints=Key(
        parts(
            name=Key(text, "Name."),
            type=Key(choice("revolute", "prismatic", "fixed"), "Kind of joint."),
            unit=Key(
                choice("rad", "m"),
                "Unit of the joint variable.",
                lambda joint: "m" if joint.type == "prismatic" else "rad",
            ),
            parameters=Key(table(number), "Parameters, m and rad."),
            axis=Key(vector3, "Axis: unit vector in the joint frame."),
            limits=Key(array(number, 2) | None, "Limits, rad or m; null if there are none."),
            sign=Key(choice(1, -1), "Sign; -1 reverses the positive direction."),
            gear_ratio=Key(number | None, "Motor turns per joint turn."),
            mass_kg=Key(size | None, "Mass of the link that the joint moves, kg.", "mass"),
            com_m=Key(vector3 | None, "Centre of mass in the link's frame, m."),
            tolerance=Key(table(number), "Tolerances, one standard deviation each, m and rad."),
            mimic=Key(_MIMIC | None, "Mimic joint, which follows another joint."),
            coupling=Key(
                table(number), "Movement of the joint per unit of other joint variables, added to its own variable."
            ),
            passive=Key(flag, "True for a joint without a motor, which moves by its coupling alone.", "is_passive"),
            link=Key(text | None, "Name of the link that the joint moves."),
        ),
        "Joints in chain order.",
    ),
    branches=Key(
        parts(
            name=Key(text, "Name of the joint, and of its column in pose files.", "joint.name"),
            parent=Key(text | None, "Joint whose link carries it; null for the base."),
            type=Key(choice("revolute", "prismatic", "fixed"), "Kind of joint.", "joint.type"),
            position=Key(number, "Position where the poses have no column for it, rad or m."),
            mimic=Key(
                _MIMIC | None,
                "Joint that it follows, in place of a column of its own; null if it moves by itself.",
                "joint.mimic",
            ),
            mass_kg=Key(number | None, "Mass of its link, kg; null if it has none.", "joint.mass"),
            com_m=Key(array(number) | None, "Centre of mass in the link's frame, m; null if it has none.", "joint.com"),
        ),
        "Joints outside the chain that move mass, such as those of another arm.",
    ),
    moved_mass_kg=Key(size | None, "Mass that the joint moves, kg; null if unknown."),
    reach=Key(
        table(
            part(
                sampled_m=Key(size | None, "Largest sampled reach over the joint ranges, m."),
                bound_m=Key(size | None, "Upper bound of the reach, m."),
            )
        ),
        "Reach of each target from the base.",
    ),
).named(about="Content of a robot file or URDF.")


EFFECTS = part(
    effects=Key(
        parts(
            name=Key(text, "Name in files and results."),
            summary=Key(text, "Description of the effect."),
            equation=Key(text, "Equation of the effect."),
            unit=Key(text, "Unit of the coefficients."),
            usual_size=Key(text, "Usual size on industrial arms."),
            usual_range=Key(
                array(size, 2),
                "Smallest and largest usual size on industrial arms, in the unit of the coefficients.",
                optional=True,
            ),
            needs=Key(text, "Requirements on the data and the robot file."),
            confused_with=Key(text, "Effects that it can be confused with."),
            source=Key(text, "Source of the equation."),
            example=Key(text, "Example of an entry in a robot file."),
            per_joint=Key(flag, "True if the effect acts on each joint by itself."),
            is_constant=Key(flag, "True if the effect can be absorbed into the constants of the robot file."),
            offered=Key(flag, "True if the effect can be fitted to these poses; only with a robot.", optional=True),
            why=Key(text | None, "Reason why it cannot be fitted.", optional=True),
            joints=Key(array(text), "Joints that it can act on.", optional=True),
            coefficients=Key(
                parts(name=Key(text, "Name."), unit=Key(text, "Unit of the value.")),
                "Coefficients that would be fitted.",
                optional=True,
            ),
        ),
        "Effects in the order of the catalogue.",
    )
).named(about="Catalogue of effects.")

SIMULATE = part(
    n_poses=Key(count, "Number of rows.", "data.n"),
    effects=Key(
        array(text),
        "Effects of the robot file.",
        lambda simulated: [str(effect.get("effect")) for effect in simulated.robot.effects],
    ),
    outlier_lines=Key(array(ordinal), "Lines of the simulated outliers."),
    file_sha256=Key(
        digest, "SHA-256 of the written file.", lambda simulated: sha256(simulated.csv().encode()).hexdigest()
    ),
    outside_validity=OUTSIDE_KEY,
).named(about="Properties of a file of simulated poses.")

EXPORT = part(
    format=Key(text, "Format of the written file: urdf, mdh, json, ur-calibration …"),
    file_sha256=Key(
        digest, "SHA-256 of the written file.", lambda exported: sha256(exported.text.encode()).hexdigest()
    ),
    urdf_sha256=Key(
        digest | None, "SHA-256 of the URDF if one was written; null for a file of another format.", lambda _: None
    ),
    not_carried=Key(array(text), "Parts of the model that the format cannot represent."),
    refitted=Key(
        array(text),
        "Effects that the format lacks and that its numbers take up as far as they can, by another fit.",
        optional=True,
    ),
    arm=Key(
        text | None, "Arm of Universal Robots that the differences refer to; null for other formats.", optional=True
    ),
    tool=Key(
        part(
            xyz_m=Key(array(number), "Place, m."),
            rpy_rad=Key(array(number), "Roll, pitch and yaw about fixed axes, rad."),
        ),
        "Measured target in the last frame of the format, to be set as the tool of the controller.",
        optional=True,
    ),
    remaining_error=Key(
        part(
            n_poses=Key(ordinal, "Number of poses.", "poses"),
            position=Key(
                part(
                    rms_m=Key(number, "Root mean square, m.", "position_rms"),
                    max_m=Key(number, "Largest distance, m.", "position_max"),
                ),
                "Distance between the target's positions.",
                "",
            ),
            orientation=Key(
                part(
                    rms_rad=Key(number, "Root mean square, rad.", "orientation_rms"),
                    max_rad=Key(number, "Largest angle, rad.", "orientation_max"),
                ),
                "Angle between the target's orientations.",
                "",
            ),
        ),
        "Difference between the model and what the format holds, over poses within the joint limits.",
        "remaining",
        optional=True,
    ),
).named(about="Export of a model for a controller, a driver or a simulator.")
