"""OpenSCENARIO files: entities, what they do at first, and acts whose events have triggers."""

from pathlib import Path

from made_maps import opendrive

BOX = (
    '<BoundingBox><Center x="{x}" y="0" z="0.8"/><Dimensions length="{length}" width="2.0" height="1.6"/></BoundingBox>'
)
VAN = f'<Vehicle name="box" vehicleCategory="van">{BOX.format(x=2.0, length=6.0)}</Vehicle>'
CAR = '<Vehicle name="car" vehicleCategory="car">' + BOX.format(x="${$middle / 2}", length=5.0) + "</Vehicle>"
PLAIN = f'<Vehicle name="plain" vehicleCategory="car">{BOX.format(x=0.0, length=5.0)}</Vehicle>'
ON_TIME = '<TimeReference><Timing domainAbsoluteRelative="{}" scale="1.0" offset="0"/></TimeReference>'
RELATIVE, ABSOLUTE, UNTIMED = (
    ON_TIME.format("relative"),
    ON_TIME.format("absolute"),
    "<TimeReference><None/></TimeReference>",
)
STAND = "<PrivateAction><TeleportAction><Position>{}</Position></TeleportAction></PrivateAction>"
SPEED = (
    "<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape='{shape}' value='{lasts}'"
    " dynamicsDimension='time'/><SpeedActionTarget><AbsoluteTargetSpeed value='{speed}'/></SpeedActionTarget>"
    "</SpeedAction></LongitudinalAction></PrivateAction>"
)
CHANGE = (
    "<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape='cubic' value='4'"
    " dynamicsDimension='time'/><LaneChangeTarget>{target}</LaneChangeTarget></LaneChangeAction></LateralAction>"
    "</PrivateAction>"
)
AT = "<ByValueCondition><SimulationTimeCondition value='{}' rule='{}'/></ByValueCondition>"
STATE = (
    "<ByValueCondition><StoryboardElementStateCondition storyboardElementType='{}' storyboardElementRef='{}'"
    " state='{}'/></ByValueCondition>"
)


def when_of(name: str, condition: str) -> str:
    """A condition on an entity."""
    return (
        "<ByEntityCondition><TriggeringEntities triggeringEntitiesRule='any'>"
        f"<EntityRef entityRef='{name}'/></TriggeringEntities><EntityCondition>{condition}</EntityCondition>"
        "</ByEntityCondition>"
    )


def world(x: float | str, y: float = -1.75, heading: str = "") -> str:
    return f'<WorldPosition x="{x}" y="{y}" {heading}/>'


def follow(vertices: dict[float, str], timing: str = RELATIVE, more: str = "") -> str:
    line = "".join(f'<Vertex time="{t}"><Position>{place}</Position></Vertex>' for t, place in vertices.items())
    return (
        f"<PrivateAction><RoutingAction><FollowTrajectoryAction {more}><TrajectoryRef><Trajectory closed='false'>"
        f"<Shape><Polyline>{line}</Polyline></Shape></Trajectory></TrajectoryRef>{timing}</FollowTrajectoryAction>"
        "</RoutingAction></PrivateAction>"
    )


def when(*conditions: str, delay: float = 0.0, edge: str = "none", tag: str = "StartTrigger") -> str:
    held = "".join(
        f"<Condition name='c' delay='{delay}' conditionEdge='{edge}'>{one}</Condition>" for one in conditions
    )
    return f"<{tag}><ConditionGroup>{held}</ConditionGroup></{tag}>"


def act(name: str, actor: str, events: dict[str, tuple[str, str]], trigger: str = "<StartTrigger/>") -> str:
    """An act of an actor, with events: an action and a trigger by name."""
    made = "".join(
        f"<Event name='{event}' priority='overwrite'><Action name='{event}_action'>{action}</Action>{start}</Event>"
        for event, (action, start) in events.items()
    )
    return (
        f"<Act name='{name}'><ManeuverGroup name='{name}_g' maximumExecutionCount='1'><Actors"
        f" selectTriggeringEntities='false'><EntityRef entityRef='{actor}'/></Actors><Maneuver name='{name}_m'>{made}"
        f"</Maneuver></ManeuverGroup>{trigger}</Act>"
    )


def write(folder: Path, entities: dict[str, str], init: dict[str, str], acts: str = "", stop: str = "") -> Path:
    """A scenario on a road along x from -150 to 150 m."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "made.xodr").write_text(opendrive())
    objects = "".join(f'<ScenarioObject name="{name}">{entity}</ScenarioObject>' for name, entity in entities.items())
    first = "".join(f'<Private entityRef="{name}">{actions}</Private>' for name, actions in init.items())
    path = folder / "made.xosc"
    path.write_text(
        '<?xml version="1.0"?><OpenSCENARIO><FileHeader revMajor="1" revMinor="2"/><ParameterDeclarations>'
        '<ParameterDeclaration name="middle" parameterType="double" value="3.0"/></ParameterDeclarations>'
        '<CatalogLocations><VehicleCatalog><Directory path="catalogs"/></VehicleCatalog></CatalogLocations>'
        f'<RoadNetwork><LogicFile filepath="made.xodr"/></RoadNetwork><Entities>{objects}</Entities><Storyboard><Init>'
        f"<Actions>{first}</Actions></Init><Story name='s'>{acts}</Story>{stop}</Storyboard></OpenSCENARIO>"
    )
    return path
