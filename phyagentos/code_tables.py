"""The rows of the table of error codes, by phase: a code, then what it means. `codes` reads them."""

AUTHORED = """
DUPLICATE_NAME       A key, value or block stands twice, or two packages offer a leaf or plug-in of one name.
WORLD_CONFLICT       Targets cannot share a world, or not the one that the goal gives them, or be repeated in it alone.
SCENE_INVALID        No collision-free placement was found, or bodies have sizes, forms or colours that cannot be meant.
MODEL_INVALID        MuJoCo cannot read a model, or its arm or fingers are not as the profile says.
AMBIGUOUS_REFERENCE  A reference names a node that `foreach` made several of.
API_KEY_MISSING      The environment variable that holds a model's key is not set.
BROKEN_BEHAVIOURS    A Python package of leaves cannot be imported or registered.
BROKEN_PLUGIN        What an installed package announces does not load, or is of another kind.
BROKEN_PREDICATES    A file of predicates in a project's folder cannot be loaded.
BROKEN_TREE          A tree is wrong, or uses one that is: a key or output that nothing writes, two actions at once.
CONTEXT_TOO_LARGE    A token budget is too small for the head of a context and its question.
CYCLE                Nodes wait for each other, or goal graphs or trees contain each other or themselves.
EMPTY_FOREACH        A `foreach` names no value.
FRONT_MATTER_MISSING A document does not begin with its front matter.
INCLUDE_DIFFERS      An included goal graph has another scene, or calls another object by a name.
INVALID_CONTRACT     A session's contract lacks something or holds a value of the wrong kind.
INVALID_ID           A request names an id with characters that no id may have.
INVALID_LINE         A line of LOG.md is no event.
INVALID_NAME         A name holds signs that names may not have, or too many.
INVALID_PARAMETER    An argument is of the wrong type or out of range.
INVALID_VALUE        A value is of the wrong type or out of range.
LEADS_OUT            A workspace, or the model of a target, names a file outside.
LIMITS_MISSING       safety.yaml lacks the target, or one of its limits.
MISSING_KEY          A key that the format needs is missing.
MISSING_PARAMETER    An argument that the skill needs is missing.
MISSING_PORT         A port that the leaf or subtree needs is missing.
MODEL_MISSING        A target names a model file that is not there.
ALIKE                A goal names one of several objects that look alike; a warning.
NAME_MISMATCH        A name differs from that of its file or folder.
NOTHING_SEEN         A node decides on what is seen, and no session before it sees anything.
NOTHING_TO_ACCEPT    A node, or the goal, holds nothing by which it could be accepted.
NOT_A_KEY            A port is wired to something that is no key of a tree.
NOT_A_LEAF           A registered class does not derive from `Leaf`.
NOT_A_NODE           A value of a tree is no node.
NOT_A_NUMBER         A comparison needs a number.
NOT_A_PREDICATE      A condition of a tree is no predicate.
NOT_A_WIRING         The ports of a node are no mapping.
NOT_PLANNABLE        No plan is made for a predicate of this form.
NOT_COMPARED         A number stands without a comparison, or a truth with one.
NO_CANDIDATE         No skill and target together guarantee what is required.
OVERLAP              Two bodies of a scene begin inside of each other, or one inside the robot.
PREDICATE_SYNTAX     A predicate cannot be parsed.
UNCLOSED_FENCE       Nothing closes a fenced block of a document.
UNSUPPORTED          A movable body of a scene begins in the air, with nothing below it to stand on.
UNKNOWN_NAME         Nothing of the kind that stands in brackets has such a name there.
UNREADABLE_FILE      A file cannot be read, is no regular file, has more than 16 MiB, or is no text.
UNSOURCED_LIMIT      A limit of safety.yaml names no source of its number.
OLD_REFERENCE        A tree refers to a key as `$name`; `${name}` is the present form (a warning).
WRONG_ARGUMENT       An argument of a predicate is of the wrong kind.
WRONG_ARGUMENTS      A predicate has too many or too few arguments.
WRONG_DOCUMENT       The front matter names another document.
WRONG_KIND           A file is of another kind than a command takes, or of none that is known.
WRONG_LENGTH         A list has not one value per joint.
WRONG_TYPE           A mapping, list or text stands where another kind belongs.
WRONG_UNIT           A limit is given in another unit than its check uses.
XML_SYNTAX           The text is not XML, or declares a document type.
YAML_SYNTAX          The text is not YAML, holds a value that does not fit its form or tag, or stands for too many.
"""

OPERATION = """
ALREADY_OVER      The goal or the session has ended: its verdict or its state is final.
CONTRADICTS_DONE  An amendment changes or takes out what has begun already.
EXTRA_MISSING        A package, a module, a Python environment or the configuration that a command needs is missing.
GOAL_DIFFERS      A goal of this name was begun with another graph.
INVALID_RATE      A rate is not the control rate divided by a whole number.
MIXED_TARGETS     Sessions of different targets would be exported into one data set.
NOT_A_RUN         The folder is no run of a suite.
NOT_A_WORKSPACE   The folder is no workspace.
NOT_BY_HAND       An edit by hand may not change this field.
NOT_EXECUTED         The session never ran, or left nothing that could be run again or exported.
NOT_RUNNING       No workspace of this machine is running.
NOT_LATCHED       There is no latched emergency stop to reset.
NOT_PROMOTED      A lesson has not proved itself as a skill, or a skill was not made of one.
NO_JOURNAL        The workspace has no such partition of the journal.
POLICY_MISSING    A policy server of a suite cannot be started, or does not listen.
REASON_MISSING    A reset of the emergency stop needs a reason.
RUN_BUSY          Another process works on the run.
RUN_DIFFERS          A run has changed since it began, cannot be read, or has no episode in common with the other.
SETUP_FAILED      An environment could not be made.
SOCKETS_UNSAFE    The folder of the sockets can be used by others.
TURN_OVER         An agent answers a turn that does not await an answer.
UNTRUSTED_PYTHON  A workspace holds Python that is not known from here.
WATCHED_ALREADY   Another watchdog supervises the workspace.
WOULD_OVERWRITE   A file stands where one was to be written.
HIDDEN_TEXT       A proposal holds characters that are not seen as they are.
NOT_APPROVED      A proposed goal has no approval of exactly its bytes.
NOT_PERMITTED     A proposed goal does more than the operator's policy permits.
PROPOSAL_CHANGED     A proposal is not the one that was decided on, could still change, or was decided before.
TOOL_NOT_OFFERED  The server was started with a level that does not include the tool.
TOO_LARGE         A proposal, or the arguments of a tool, have too many bytes.
TOO_MANY_PROPOSALS So many proposals wait for a decision that no other is taken.
"""

STORE = """
BODY_UNREADABLE      The body of a record cannot be read.
CHECKPOINT_UNUSED    The checkpoint fits no place in the journal and is not used.
CHECKPOINT_WRONG     The checkpoint holds another state than the records before it lead to.
END_TORN             A segment ends in an unacknowledged batch; the next writer cuts it.
EVIDENCE_BUSY        Another process prunes the evidence.
EVIDENCE_UNREADABLE  A bundle lacks a file, or holds one that cannot be read.
EVIDENCE_UNWRITABLE  The evidence folder cannot be changed.
JOURNAL_CLOSED       The journal was closed.
JOURNAL_DAMAGED      Bytes of the journal are not as they were written.
JOURNAL_LOCKED       Another process has held the partition's lock for ten seconds.
JOURNAL_MOVED        A file or folder of the journal was moved or replaced while it was open.
JOURNAL_NOT_DURABLE  The disk did not confirm a write; the process must end.
JOURNAL_UNREADABLE   The system refused to read a file of the journal.
JOURNAL_WRITE_FAILED The disk took no record, and none was acknowledged.
LANE_UNCLEAR         Several hosts have written here; name a partition with --lane.
LOOK_DIFFERS         Perception now reads something else than when a look was recorded.
LOOK_MISSING         A bundle lacks what a snapshot or a sample was perceived from.
MANIFEST_DAMAGED     A manifest of evidence does not hold what it should.
MISMATCH             A file of evidence has another hash than in its manifest.
MISSING              A bundle of evidence is gone, or a file that its manifest still lists.
NOTHING_OBSERVED     ENVIRONMENT.md holds no snapshot yet.
POINTER_BROKEN       A snapshot points at pixels that no look of its bundle holds.
RECORDS_MISSING      Records that were given a number are gone.
RECORD_DAMAGED       A record is not as it was written.
RECORD_ILLEGAL       The lifecycle does not allow a record there.
RECORD_TOO_LARGE     A record is larger than a journal line may be.
SEGMENT_MISLINKED    A segment does not fit the one before it.
SEGMENT_UNREADABLE   A segment is no regular file, or the system refuses to read it.
SEGMENT_TWICE        A segment stands in the partition and in the archive.
SETTINGS_CHANGED     A settings file is not the one that the session ran with.
UNLISTED             A bundle holds a file that its manifest does not name.
UNSEALED             A bundle has no manifest.
"""

PREFLIGHT = """
ACTION_SPACE_INVALID     A description of an action space contradicts itself.
NOT_OFFERED              The target does not offer an observation, action, capability or operation that is needed.
CHUNK_LENGTH             A chunk is longer or shorter than the target takes.
CLAMP_UNBOUNDED          A projection into range is requested without a range.
CONTRACT_MISMATCH        runtime_contract.yaml counts on another period, step, rate or mode than the target.
ENDPOINT_INVALID         The endpoint of a policy is no address.
NOT_OBSERVED             An argument or a condition names what no observation has shown.
GRIPPER_MISMATCH         One side commands a gripper that the other does not have.
HOLD_BROKEN              A hold condition, or a constraint of the goal, is false already in the world as observed.
JOINT_MISSING            The target has a joint for which the source gives no value.
LIMIT_EMPTY              The least value of a limit is not below its greatest.
LIMIT_TOO_NARROW         A limit of safety.yaml leaves no session room to do anything.
LIMIT_UNENFORCEABLE      The live target does not declare what a limit of safety.yaml is compared with, or falsely.
LIMIT_WIDER              A limit of safety.yaml is wider than the target's own.
NO_TOKEN                 The key of a target that is served elsewhere is missing, or others can read it.
NOT_ENCRYPTED            A target would be served to, or reached on, another machine without TLS.
NOT_TRUSTED              The certificate of a target that is served elsewhere is not of those that this side trusts.
NO_ENVIRONMENT           The process of a Gymnasium target does not start.
NO_DRIVER                No driver moves a target of this kind, or none of the name that the profile gives.
NOT_CHECKED              A session was to run without a preflight.
OBSERVATION_DTYPE        A policy takes another element type than the sensor gives.
OBSERVATION_FRAME        A policy takes an observation in another frame than the sensor gives.
OBSERVATION_MODALITY     A policy takes another modality than the sensor measures.
OBSERVATION_RATE         A policy needs an observation more often than the sensor measures.
OBSERVATION_SHAPE        A policy takes an array of another shape than the sensor gives, or its form is not declared.
OBSERVATION_UNIT         A policy takes another unit than the sensor gives.
OPERATION_FORBIDDEN      runtime_contract.yaml does not permit an operation that the skill needs.
OUT_OF_REACH             The session's object is beyond the arm's reach, for every grasp.
OUTSIDE_WORKSPACE        Every candidate would bring the tool beyond the workspace of safety.yaml.
PARAMETER_INVALID        An argument of the contract is of the wrong type or out of range.
POLICY_MISMATCH      A policy, or its server, is not as SKILL.md describes it, or is too slow for its chunks.
POLICY_UNREACHABLE       No policy server answers.
PRECONDITION_UNMET       A precondition is false or unknown in the world as observed.
RATE_UNBRIDGED           No resampling leads from the source's rate to the target's.
REPRESENTATION_UNBRIDGED No bridge leads from the source's representation to the target's.
SENSOR_MISSING           No sensor of sensors.yaml provides an observation that is needed.
SENSOR_MODALITY          A sensor cannot measure what it is declared to provide.
SENSOR_RATE              A sensor measures too seldom for fresh facts, or oftener than the world changes.
SENSOR_UNREAD            No pipeline of perception.yaml reads a sensor that is needed.
SKILL_KIND_UNSUPPORTED   This runtime cannot run skills of this kind.
START_OUTSIDE            The tool stands outside the workspace, or in a keep-out volume, before anything has moved.
TARGET_MISMATCH          The live target differs from TARGETS.md.
TARGET_UNAVAILABLE       The target's worker cannot be started.
TOO_HEAVY                What the session takes hold of may weigh more than the arm carries.
TOO_SLIPPERY             What the session takes hold of weighs more than friction can bear between its fingers.
TREE_INVALID             The skill's tree cannot be built.
VERSION_MISMATCH         Skill, policy, target and this software are not of versions that go together.
"""

SUPERVISION = """
PREFLIGHT_TIMED_OUT     The check of a session took longer than its contract allows; nothing was commanded.
QUEUE_TIMED_OUT         A session waited longer for its target, or its resources, than its contract allows.
RESET_FORBIDDEN         The target would have to begin its world anew, and the contract does not permit that.
RESOURCE_UNAVAILABLE    A resource that the session needs is held by a target that is broken.
"""

PLANNING = """
IN_COLLISION            The arm, or every goal posture, touches something.
NO_FREE_SITE            There is no free room at the destination.
LOAD_LOST               What was to travel on an object did not arrive with it.
LOOKAHEAD_FAILED        The requested look-ahead could not be carried out.
LOOKAHEAD_LOW           The chance of success that was foreseen is too low, so nothing was moved.
NO_IK                   No joint posture reaches the requested pose.
NO_MODEL                The planner got a request before it was given a robot.
NO_PATH_FOUND           No path between start and goals was found in the budget.
NO_SLIDE                The object to open or close neither slides nor turns.
NO_SPACE                The destination is too small for the object.
TILT                    No carrying motion within the tilt limit was found.
TOO_SHORT               The push is shorter than the fingers need.
TOO_TALL                The object to push is so tall that the palm would meet it, or the push topple it.
TOO_WIDE                The object is wider than the gripper opens.
UNKNOWN_ENTITY          A request names something that the world does not hold.
"""

EXECUTION = """
AGENT_GAVE_UP           The agent that directed a session ended it as failed.
CALLS_SPENT             The agent that directed a session made every call that it may, and did not finish.
ALREADY_MET             The acceptance was true before the session, so that nothing was commanded.
CONTACT                 A guarded motion met something, and stopped.
COOLING_DOWN            The child of a cooldown ended too short a time ago.
GRASP_LOST              The object was held and is not any more.
GRASP_MISSED            The fingers closed and do not hold the object.
HOLD_VIOLATED           A condition that had to hold all through did not.
LEAF_ERROR              A leaf failed by an error of its own.
MOTION_CONFLICT         Another robot stood in the way of a motion for too long.
NOT_AT_START            A motion does not begin where the arm stands.
NOT_VISIBLE             The object is believed, but was not seen.
OBSERVATION_UNAVAILABLE A policy's observation is missing, old, dark, or of another form than declared.
NO_PROGRESS             No control period passed for longer than allowed, or the tree neither commands nor plans.
OUT_OF_TIME             A timeout of the tree ran out, in simulated time.
POLICY_FAULT            The policy server reported a fault, or its answer cannot be read.
POLICY_LOST             The policy server has gone, or has sent nothing for longer than the contract allows.
POLICY_STALLED          The policy server has given no sign of life for longer than its heartbeat allows.
POLICY_UNDERRUN         The rows of a chunk ran out before the next one came, and the skill declares that it fails then.
STALLED                 A motor does not follow its set-points.
STILL_HELD              The fingers opened and still hold the object.
TIMED_OUT               A time limit of the contract was reached.
UNMET                   A condition of the tree is false or unknown."""

VERIFICATION = """
CONSTRAINT_VIOLATED A condition that had to hold all through did not.
ADAPTER_REFUSED     A command did not fit the target: an adapter or the target itself refused it.
BUDGET              The goal's budget of sessions or simulated time is spent.
EVIDENCE_MISSING    The evidence does not show whether the objective was met.
EXECUTION_MISSING   The bundle does not record how the execution ended.
NOT_JUDGED          A session has no verdict yet to which a judgement could be added.
JUDGES_DISAGREE     One judge calls true what another calls false.
JUDGE_FAILED        A judge gave no usable answer, and nothing else is open.
MODEL_MALFORMED     A model's answer has another form than the requested one.
MODEL_REFUSED       A model's server answered with an error.
MODEL_UNREACHABLE   A model did not answer in time.
IMPOSSIBLE          This skill has no motion for this request; another one may.
NO_PLAN             No motion was found.
OBJECT_HIDDEN       The object is believed to exist and was not seen.
OBJECT_MOVED        The object was not where it had been when the motion was planned.
OUTPUT_MISSING      A session succeeded without an output that a later node needs.
POLICY_FAILED       The policy gave no usable action.
PLACED_WRONG        The object was moved and is not where it was wanted.
SENSOR_STALE        The latest measurement is too old to describe the world.
UNDECIDABLE         Everything was seen, and still a criterion cannot be decided.
UNKNOWN             None of the other causes.
WITHOUT_EFFECT      The robot moved, the object did not."""

HOPELESS = """
AMBIGUOUS               The contract depends on which of several objects that look alike is which.
CANCELLED               An end was requested.
CRITERIA_CONTRADICT     Two criteria exclude one another, so that no world meets the contract.
NOTHING_CHANGED         No command was executed and nothing moved, although the skill reported success.
NO_CRITERIA             The contract holds nothing that could be accepted.
OBJECT_GONE             The object is not in the believed world.
"""

SAFETY = """
ABORTED             A command waited for other targets of its world, and its session was to end.
CLAMPED             A value was projected into its range, as the contract declares.
CLAMPED_GRIPPER     An opening was projected into the gripper's range, as safety.yaml allows.
CLAMPED_JOINT       A joint set-point was projected into its range, as safety.yaml allows.
COLLISION           The commanded posture would touch something.
COLLISION_STOP      The target stopped itself: a contact force was too large.
DEADMAN             No command came in time while the arm moved; the target brought itself to rest.
DISCONTINUOUS       A chunk jumps further than the target's velocity permits.
DRIVES_OFF          A stop of category 1 ended the commands of the session.
ESTOPPED            The emergency stop is latched.
EXPIRED             The command came after its expiry.
EXPIRY_TOO_LATE     The command would be valid for longer than allowed.
GRIPPER_FORCE       The target's gripper can press harder than allowed.
GRIPPER_WIDTH       The opening is outside the gripper's range.
JOINT_ACCELERATION  The velocity set-points change too fast.
JOINT_JERK          The acceleration changes too much within one control period.
JOINT_POSITION      A joint set-point is outside its range.
JOINT_VELOCITY      A joint set-point, or the difference of two rows, is too fast.
KEEP_OUT            The tool centre point would enter a keep-out volume.
NOT_FINITE          A set-point is NaN or infinite.
POSE_UNREACHABLE    No posture near the one before reaches a pose of the tool that a policy commands.
PROTECTIVE_STOP     The target stopped itself: a joint or the tool was outside of its limits.
RATE                Commands come faster than allowed.
RESET_NEEDED        The robot was stopped by its own means; a person has to reset it before a session may begin.
ROTATION_INVALID    The columns of a rotation do not form one.
SAFETY_STOP         A safety layer stopped the execution.
SESSION_LOST        The runtime gave a session up while its target waited in a shared world.
SESSION_TOO_LONG    The session has been commanding for longer than allowed.
SET_POINTS_DISAGREE The velocity rows are not the velocity of the position rows.
WORKSPACE           The tool centre point is outside the workspace.
WRONG_SHAPE         An array of a command has another shape or type than one control period.
"""

TARGET = """
BAD_TOKEN               A client of the target has no token of the newest key, or not that of the epoch.
CAMERA_SILENT           A camera gives no frames at all.
DETECTOR_MALFORMED      A detector's answer is not of the form that was agreed.
DETECTOR_REFUSED        A detector answered with an HTTP error.
DETECTOR_TIMEOUT        A detector gave no answer in time.
DETECTOR_UNREACHABLE    A detector cannot be reached.
EPISODE_CONFLICT        The target already runs an episode with another scene or seed.
FRAME_DROPPED           The latest frames of a camera were all lost.
HEARTBEAT_INCONSISTENT  Two processes beat for one target, or a worker's sequence runs backwards.
HEARTBEAT_LOST          The worker lives, and its heartbeat has not advanced for longer than the contract allows.
INVALID_CROP            A window of a camera's picture is empty, or leaves the picture.
LEASE_LOST              No watchdog has renewed the lease of a session that runs; the worker ended it.
LATCH_UNWRITABLE        The disk takes no latch of the emergency stop, and has no reserve for it.
LOG_UNWRITABLE          The target cannot write its receive log, so it accepts no command.
MALFORMED               A message on the wire could not be read.
NO_AUTHORITY            A command came without a claim.
NO_GROUND_TRUTH         The ground truth was requested, and is not offered.
NO_GRAPHICS             This machine cannot draw; sensors.yaml may have `backend: ray`.
NO_STATE                Frames came before any state of the target.
NO_SCENE                The target got a request before an episode began.
OUT_OF_SEQUENCE         A command's number does not follow the one before.
PLANE_ENDED             The agent or the runtime ended before the verdict.
PLANNER_LOST            The planner process died or broke its protocol.
PROTOCOL_BROKEN         The target sent an answer to no request.
RUNNER_LOST             The worker died.
RUNTIME_LOST            No runtime runs the sessions that the agent waits for.
STALE_TOKEN             A command came under a claim that is no longer in force.
TARGET_BUSY             Another process serves the target.
TARGET_LIMIT            The target itself refused a command.
TARGET_LOST             The target no longer answers.
UNKNOWN_CAMERA          No camera of this name in sensors.yaml, or nothing in this world that carries it.
UNKNOWN_TOOL            The target has no tool of this name.
"""

# Codes of earlier releases, which documents still hold: what each is called now.
ALIASES = """
BROKEN_TREE: TWO_ACTIONS UNWRITTEN_KEY UNWRITTEN_OUTPUT
CYCLE: RECURSION
DUPLICATE_NAME: DUPLICATE_BLOCK DUPLICATE_KEY DUPLICATE_LEAF DUPLICATE_PLUGIN DUPLICATE_VALUE
EXTRA_MISSING: MODULE_MISSING RAY_MISSING ENVIRONMENT_MISSING VISION_NOT_CONFIGURED
INVALID_VALUE: INVALID_OVERRIDE
MISSING_PARAMETER: PARAMETER_MISSING
MODEL_INVALID: MODEL_UNREADABLE NO_SERIAL_CHAIN WRONG_AXIS WRONG_OPENING
NOT_EXECUTED: NO_SNAPSHOT NOTHING_TO_EXPORT
NOT_OBSERVED: NEVER_SEEN ENTITY_UNKNOWN
NOT_OFFERED: CAPABILITY_UNAVAILABLE OPERATION_UNAVAILABLE ACTION_UNAVAILABLE
POLICY_MISMATCH: POLICY_TOO_SLOW POLICY_UNDECLARED
PROPOSAL_CHANGED: PROPOSAL_OPEN PROPOSAL_DECIDED
RUN_DIFFERS: RUN_DAMAGED NOT_PAIRED
SCENE_INVALID: SCENE_OVERFULL WRONG_SCALE NOT_ALIKE
UNKNOWN_NAME: UNKNOWN_FORECASTER UNKNOWN_JUDGE UNKNOWN_BLOCK UNKNOWN_KEY UNKNOWN_LEAF UNKNOWN_NOISE_LEVEL UNKNOWN_NODE
UNKNOWN_NAME: UNKNOWN_OUTPUT UNKNOWN_PARAMETER UNKNOWN_PLUGIN UNKNOWN_PORT UNKNOWN_POSTURE UNKNOWN_PREDICATE
UNKNOWN_NAME: UNKNOWN_REPAIR UNKNOWN_REFERENCE UNKNOWN_SCENE UNKNOWN_SCORER UNKNOWN_SENSOR UNKNOWN_SKILL
UNKNOWN_NAME: UNKNOWN_TARGET UNKNOWN_TREE UNKNOWN_WORD UNKNOWN_CODE UNKNOWN_ENTRY UNKNOWN_FILE UNKNOWN_FOLDER
UNKNOWN_NAME: UNKNOWN_GOAL UNKNOWN_REQUEST UNKNOWN_SCHEMA UNKNOWN_SESSION UNKNOWN_PROPOSAL UNKNOWN_RESOURCE
UNKNOWN_NAME: UNKNOWN_DETECTOR FRAME_UNKNOWN JOINT_UNKNOWN PARAMETER_UNKNOWN RESOURCE_UNDECLARED TARGET_UNKNOWN
UNKNOWN_NAME: UNKNOWN_MATERIAL UNKNOWN_AREA UNKNOWN_BODY UNKNOWN_JOINT UNKNOWN_SITE UNKNOWN_GEOM
WORLD_CONFLICT: WORLD_DIFFERS WORLD_NOT_SHARED WORLD_SHARED PERIODS_DIFFER TARGET_IN_TWO_WORLDS
WRONG_KIND: UNKNOWN_KIND
"""
