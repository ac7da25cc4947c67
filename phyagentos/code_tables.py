"""The rows of the table of error codes, by phase: a code, then what it means. `codes` reads them."""

AUTHORED = """
MISSING_VALUE        A key, argument, port, limit, source, acceptance, reason or partition that is needed is missing.
SCENE_INVALID        Bodies find no placement without collision, overlap, hang in the air, or cannot be meant so.
UNREADABLE_FILE      A file is missing, cannot be read, is no regular file, has more than 16 MiB, or is no text.
BROKEN_PYTHON        Python of a person or installed package does not load, or raised an error in a session.
INVALID_VALUE        A value, name, argument, unit or kind of file is wrong, out of range, or not for this place.
NO_CANDIDATE         No skill and target together guarantee what is required, or nothing plans for its form.
BROKEN_TREE          A tree cannot be built: an output that nothing writes, two actions at once, a wrong subtree.
SYNTAX               A text is no predicate, XML or YAML, stands for too many values, or has an open block.
DUPLICATE_NAME       A key, value or block stands twice, or two packages offer a leaf or plug-in of one name.
WORLD_CONFLICT       Targets cannot share a world, or not the one that the goal gives them, or be repeated in it alone.
MODEL_INVALID        MuJoCo cannot read a model, or its arm or fingers are not as the profile says.
CYCLE                Nodes wait for each other, or goal graphs or trees contain each other or themselves.
LEADS_OUT            A workspace, or the model of a target, names a file outside.
UNKNOWN_NAME         Nothing of the kind that stands in brackets has such a name there.
"""

OPERATION = """
NOT_PERMITTED        A policy, contract, approval or the level of a server forbids it, or a lesson has not proved itself.
TOO_LARGE            A proposal, arguments, a context or a record has too many bytes; or too many proposals wait.
EXTRA_MISSING        A package, module, environment, key or configuration is missing, or cannot be installed.
ALREADY_OVER         The goal, session, turn or emergency stop has ended: its verdict, state or answer is final.
CHANGED              A goal, proposal, run, setting or measurement is not what was begun, decided on or recorded.
NOT_A_WORKSPACE      The folder is no workspace, or no run of a suite, or has no such partition of the journal.
NOT_EXECUTED         The session never ran, or left nothing that could be run again or exported.
NOT_RUNNING       No workspace of this machine is running.
UNTRUSTED_PYTHON  A workspace holds Python that is not known from here.
WOULD_OVERWRITE   A file stands where one was to be written.
"""

STORE = """
JOURNAL_NOT_DURABLE  The disk did not confirm a write; the process must end.
JOURNAL_LEFTOVER     A part of the journal that does not count; the next writer or reader passes over it.
WRITE_FAILED         The disk took or confirmed no record, file or latch; nothing was acknowledged.
EVIDENCE_DAMAGED     A bundle lacks a file, or holds one that cannot be read or is not as its manifest says.
JOURNAL_DAMAGED      The journal or its checkpoint is not as it was written, or against the lifecycle.
BUSY                 Another process works on the same run, workspace, journal or evidence.
"""

PREFLIGHT = """
POLICY_UNREACHABLE   No policy server answers, or it cannot be started.
NOT_OBSERVED         An argument, condition, fan-out or scene needs what no observation has shown.
NOT_SECURED          A served target has no safe key, TLS or trusted certificate, or others can use the sockets.
NO_DRIVER            No driver moves a target of this kind or name, or the process of its environment does not start.
NOT_OFFERED          Target or runtime do not offer an observation, action, operation or kind of skill.
LIMIT_INVALID        A limit of safety.yaml is empty, too narrow, wider than the target's, or unenforceable.
SENSOR_MISMATCH      No sensor that is read provides a needed observation, or not in its modality or rate.
OBSERVATION_MISMATCH A policy takes another shape, unit, dtype, frame, modality or rate than a sensor gives.
ACTION_SPACE_MISMATCH No bridge leads from the source's form, joints, gripper, rate or range to the target's.
ACTION_SPACE_INVALID     A description of an action space contradicts itself.
CHUNK_LENGTH             A chunk is longer or shorter than the target takes.
CONTRACT_MISMATCH        runtime_contract.yaml counts on another period, step, rate or mode than the target.
HOLD_BROKEN              A hold condition, or a constraint of the goal, is false already in the world as observed.
NOT_CHECKED              A session was to run without a preflight.
OPERATION_FORBIDDEN      runtime_contract.yaml does not permit an operation that the skill needs.
OUT_OF_REACH             The session's object is beyond the arm's reach, for every grasp.
OUTSIDE_WORKSPACE        Every candidate would bring the tool beyond the workspace of safety.yaml.
POLICY_MISMATCH      A policy, or its server, is not as SKILL.md describes it, or is too slow for its chunks.
PRECONDITION_UNMET       A precondition is false or unknown in the world as observed.
START_OUTSIDE            The tool stands outside the workspace, or in a keep-out volume, before anything has moved.
TARGET_MISMATCH          The live target differs from TARGETS.md.
TARGET_UNAVAILABLE       The target's worker cannot be started.
TOO_HEAVY                What the session takes hold of may weigh more than the arm carries.
TOO_SLIPPERY             What the session takes hold of weighs more than friction can bear between its fingers.
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
LEAF_ERROR              A leaf failed by an error of its own, or what adapts a policy did.
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
MODEL_FAILED         A model did not answer in time, or its server answered with an error.
CONSTRAINT_VIOLATED A condition that had to hold all through did not.
ADAPTER_REFUSED     A command did not fit the target: an adapter or the target itself refused it.
BUDGET              The goal's budget of sessions or simulated time is spent.
EVIDENCE_MISSING    The evidence does not show whether the objective was met.
EXECUTION_MISSING   The bundle does not record how the execution ended.
NOT_JUDGED          A session has no verdict yet to which a judgement could be added.
JUDGES_DISAGREE     One judge calls true what another calls false.
JUDGE_FAILED        A judge gave no usable answer, and nothing else is open.
MODEL_MALFORMED     A model's answer has another form than the requested one.
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
AMBIGUOUS            The contract or goal depends on which of several objects that look alike is which.
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
NO_EPISODE           The target got a request before an episode began, or before it gave a state.
REQUEST_INVALID      The target has no such camera or tool, offers no ground truth, or a window leaves the picture.
DETECTOR_FAILED      A detector cannot be reached, gave no answer in time, or answered with an HTTP error.
BAD_TOKEN               A client of the target has no token of the newest key, or not that of the epoch.
CAMERA_SILENT           A camera gives no frames at all.
DETECTOR_MALFORMED      A detector's answer is not of the form that was agreed.
EPISODE_CONFLICT        The target already runs an episode with another scene or seed.
FRAME_DROPPED           The latest frames of a camera were all lost.
HEARTBEAT_INCONSISTENT  Two processes beat for one target, or a worker's sequence runs backwards.
HEARTBEAT_LOST          The worker lives, and its heartbeat has not advanced for longer than the contract allows.
LEASE_LOST              No watchdog has renewed the lease of a session that runs; the worker ended it.
MALFORMED               A message on the wire could not be read.
NO_AUTHORITY            A command came without a claim.
NO_GRAPHICS             This machine cannot draw; sensors.yaml may have `backend: ray`.
OUT_OF_SEQUENCE         A command's number does not follow the one before.
PLANE_ENDED             The agent or the runtime ended before the verdict.
PLANNER_LOST            The planner process died or broke its protocol.
PROTOCOL_BROKEN         The target sent an answer to no request, or one that cannot be: time that runs backwards.
RUNNER_LOST             The worker died.
RUNTIME_LOST            No runtime runs the sessions that the agent waits for.
STALE_TOKEN             A command came under a claim that is no longer in force.
TARGET_BUSY             Another process serves the target.
TARGET_LIMIT            The target itself refused a command.
TARGET_LOST             The target no longer answers.
"""

# Codes of earlier releases, which documents still hold: what each is called now.
ALIASES = """
ACTION_SPACE_MISMATCH: CLAMP_UNBOUNDED GRIPPER_MISMATCH JOINT_MISSING RATE_UNBRIDGED REPRESENTATION_UNBRIDGED
ALREADY_OVER: TURN_OVER NOT_LATCHED
AMBIGUOUS: ALIKE
BROKEN_PYTHON: BROKEN_BEHAVIOURS BROKEN_PREDICATES NOT_A_LEAF BROKEN_PLUGIN
BROKEN_TREE: TWO_ACTIONS UNWRITTEN_KEY UNWRITTEN_OUTPUT TREE_INVALID
BUSY: RUN_BUSY EVIDENCE_BUSY WATCHED_ALREADY JOURNAL_LOCKED
CHANGED: PROPOSAL_OPEN PROPOSAL_DECIDED RUN_DAMAGED NOT_PAIRED CONTRADICTS_DONE GOAL_DIFFERS RUN_DIFFERS
CHANGED: PROPOSAL_CHANGED LOOK_DIFFERS SETTINGS_CHANGED
CYCLE: RECURSION
DETECTOR_FAILED: DETECTOR_REFUSED DETECTOR_TIMEOUT DETECTOR_UNREACHABLE
DUPLICATE_NAME: DUPLICATE_BLOCK DUPLICATE_KEY DUPLICATE_LEAF DUPLICATE_PLUGIN DUPLICATE_VALUE
EVIDENCE_DAMAGED: MISMATCH MISSING UNLISTED UNSEALED MANIFEST_DAMAGED LOOK_MISSING POINTER_BROKEN EVIDENCE_UNREADABLE
EXTRA_MISSING: MODULE_MISSING RAY_MISSING ENVIRONMENT_MISSING VISION_NOT_CONFIGURED API_KEY_MISSING SETUP_FAILED
INVALID_VALUE: INVALID_OVERRIDE INVALID_CONTRACT INVALID_ID INVALID_LINE INVALID_NAME INVALID_PARAMETER INVALID_RATE
INVALID_VALUE: NAME_MISMATCH NOT_A_KEY NOT_A_NODE NOT_A_NUMBER NOT_COMPARED NOT_A_PREDICATE NOT_A_WIRING
INVALID_VALUE: WRONG_ARGUMENT WRONG_ARGUMENTS WRONG_LENGTH WRONG_TYPE WRONG_UNIT HIDDEN_TEXT PARAMETER_INVALID
INVALID_VALUE: INCLUDE_DIFFERS AMBIGUOUS_REFERENCE MIXED_TARGETS ENDPOINT_INVALID UNKNOWN_KIND WRONG_DOCUMENT
INVALID_VALUE: WRONG_KIND OLD_REFERENCE
JOURNAL_DAMAGED: BODY_UNREADABLE RECORD_DAMAGED RECORDS_MISSING RECORD_ILLEGAL SEGMENT_MISLINKED SEGMENT_UNREADABLE
JOURNAL_DAMAGED: CHECKPOINT_WRONG
JOURNAL_LEFTOVER: END_TORN SEGMENT_TWICE CHECKPOINT_UNUSED
LIMIT_INVALID: LIMIT_EMPTY LIMIT_TOO_NARROW LIMIT_UNENFORCEABLE LIMIT_WIDER
MISSING_VALUE: MISSING_KEY MISSING_PARAMETER MISSING_PORT LIMITS_MISSING FRONT_MATTER_MISSING EMPTY_FOREACH
MISSING_VALUE: UNSOURCED_LIMIT REASON_MISSING NOTHING_TO_ACCEPT PARAMETER_MISSING LANE_UNCLEAR
MODEL_FAILED: MODEL_REFUSED MODEL_UNREACHABLE
MODEL_INVALID: MODEL_UNREADABLE NO_SERIAL_CHAIN WRONG_AXIS WRONG_OPENING
NOT_A_WORKSPACE: NOT_A_RUN NO_JOURNAL
NOT_EXECUTED: NO_SNAPSHOT NOTHING_TO_EXPORT
NOT_OBSERVED: NEVER_SEEN ENTITY_UNKNOWN NOTHING_SEEN NOTHING_OBSERVED
NOT_OFFERED: CAPABILITY_UNAVAILABLE OPERATION_UNAVAILABLE ACTION_UNAVAILABLE SKILL_KIND_UNSUPPORTED
NOT_PERMITTED: NOT_APPROVED TOOL_NOT_OFFERED NOT_BY_HAND NOT_PROMOTED
NOT_SECURED: NO_TOKEN NOT_ENCRYPTED NOT_TRUSTED SOCKETS_UNSAFE
NO_CANDIDATE: NOT_PLANNABLE
NO_DRIVER: NO_ENVIRONMENT
NO_EPISODE: NO_SCENE NO_STATE
OBSERVATION_MISMATCH: OBSERVATION_DTYPE OBSERVATION_FRAME OBSERVATION_MODALITY OBSERVATION_RATE OBSERVATION_SHAPE
OBSERVATION_MISMATCH: OBSERVATION_UNIT
POLICY_MISMATCH: POLICY_TOO_SLOW POLICY_UNDECLARED
POLICY_UNREACHABLE: POLICY_MISSING
REQUEST_INVALID: UNKNOWN_CAMERA UNKNOWN_TOOL INVALID_CROP NO_GROUND_TRUTH
SCENE_INVALID: SCENE_OVERFULL WRONG_SCALE NOT_ALIKE UNSUPPORTED OVERLAP
SENSOR_MISMATCH: SENSOR_MISSING SENSOR_MODALITY SENSOR_RATE SENSOR_UNREAD
SYNTAX: PREDICATE_SYNTAX XML_SYNTAX YAML_SYNTAX UNCLOSED_FENCE
TOO_LARGE: TOO_MANY_PROPOSALS CONTEXT_TOO_LARGE RECORD_TOO_LARGE
UNKNOWN_NAME: UNKNOWN_FORECASTER UNKNOWN_JUDGE UNKNOWN_BLOCK UNKNOWN_KEY UNKNOWN_LEAF UNKNOWN_NOISE_LEVEL UNKNOWN_NODE
UNKNOWN_NAME: UNKNOWN_OUTPUT UNKNOWN_PARAMETER UNKNOWN_PLUGIN UNKNOWN_PORT UNKNOWN_POSTURE UNKNOWN_PREDICATE
UNKNOWN_NAME: UNKNOWN_REPAIR UNKNOWN_REFERENCE UNKNOWN_SCENE UNKNOWN_SCORER UNKNOWN_SENSOR UNKNOWN_SKILL
UNKNOWN_NAME: UNKNOWN_TARGET UNKNOWN_TREE UNKNOWN_WORD UNKNOWN_CODE UNKNOWN_ENTRY UNKNOWN_FILE UNKNOWN_FOLDER
UNKNOWN_NAME: UNKNOWN_GOAL UNKNOWN_REQUEST UNKNOWN_SCHEMA UNKNOWN_SESSION UNKNOWN_PROPOSAL UNKNOWN_RESOURCE
UNKNOWN_NAME: UNKNOWN_DETECTOR FRAME_UNKNOWN JOINT_UNKNOWN PARAMETER_UNKNOWN RESOURCE_UNDECLARED TARGET_UNKNOWN
UNKNOWN_NAME: UNKNOWN_MATERIAL UNKNOWN_AREA UNKNOWN_BODY UNKNOWN_JOINT UNKNOWN_SITE UNKNOWN_GEOM
UNREADABLE_FILE: MODEL_MISSING JOURNAL_UNREADABLE
WORLD_CONFLICT: WORLD_DIFFERS WORLD_NOT_SHARED WORLD_SHARED PERIODS_DIFFER TARGET_IN_TWO_WORLDS
WRITE_FAILED: JOURNAL_CLOSED JOURNAL_MOVED JOURNAL_WRITE_FAILED EVIDENCE_UNWRITABLE
WRITE_FAILED: LATCH_UNWRITABLE LOG_UNWRITABLE
"""
