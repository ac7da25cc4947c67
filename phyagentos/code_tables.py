"""The table of error codes: phase, who acts and what another attempt is worth, then each code and what it means."""

from collections.abc import Mapping

ROWS: Mapping[tuple[str, str, str], str] = {
    ("authoring", "author", "edited"): """
AMBIGUOUS       The contract or goal depends on which of several objects that look alike is which.
BROKEN_PYTHON   Python of a person or installed package does not load, or raised an error in a session.
BROKEN_TREE     A tree cannot be built: an output that nothing writes, two actions at once, a wrong subtree.
CYCLE           Nodes wait for each other, or goal graphs or trees contain each other or themselves.
DUPLICATE_NAME  A key, value or block stands twice, or two packages offer a leaf or plug-in of one name.
INVALID_VALUE   A value, name, argument, unit or kind of file is wrong, out of range, or not for this place.
LEADS_OUT       A workspace, or the model of a target, names a file outside.
MISSING_VALUE   A key, argument, port, limit, source, acceptance, reason or partition that is needed is missing.
MODEL_INVALID   MuJoCo cannot read a model, or its arm or fingers are not as the profile says.
NO_CANDIDATE    No skill and target together guarantee what is required, or nothing plans for its form.
SCENE_INVALID   Bodies find no placement without collision, overlap, hang in the air, or cannot be meant so.
SYNTAX          A text is no predicate, XML or YAML, stands for too many values, or has an open block.
UNKNOWN_NAME    Nothing of the kind that stands in brackets has such a name there.
UNREADABLE_FILE A file is missing, cannot be read, is no regular file, has more than 16 MiB, or is no text.
WORLD_CONFLICT  Targets cannot share a world, or not the one that the goal gives them, or be repeated in it alone.
""",
    ("operation", "operator", "edited"): """
ALREADY_OVER     The goal, session, turn or emergency stop has ended: its verdict, state or answer is final.
CHANGED          A goal, proposal, run, setting or measurement is not what was begun, decided on or recorded.
EXTRA_MISSING    A package, module, environment, key or configuration is missing, or cannot be installed.
NOT_A_WORKSPACE  The folder is no workspace, or no run of a suite, or has no such partition of the journal.
NOT_EXECUTED     The session never ran, has no verdict yet, or left nothing to run again or export.
NOT_PERMITTED    A policy, contract, approval or server level forbids it, or a lesson has not proved itself.
NOT_RUNNING      No workspace or server of a fleet runs, or an agent or runtime has ended before the verdict.
TOO_LARGE        A proposal, arguments, a context or a record has too many bytes; or too many proposals wait.
UNTRUSTED_PYTHON A workspace holds Python that is not known from here.
WOULD_OVERWRITE  A file stands where one was to be written.
""",
    ("store", "operator", "later"): """
BUSY                Another process works on the same run, workspace, journal, evidence or target.
EVIDENCE_DAMAGED    A bundle lacks a file, or holds one that cannot be read or is not as its manifest says.
JOURNAL_DAMAGED     The journal or its checkpoint is not as it was written, or against the lifecycle.
JOURNAL_LEFTOVER    A part of the journal that does not count; the next writer or reader passes over it.
JOURNAL_NOT_DURABLE The disk did not confirm a write; the process must end.
WRITE_FAILED        The disk took or confirmed no record, file or latch; nothing was acknowledged.
""",
    ("preflight", "author", "edited"): """
ACTION_SPACE_MISMATCH No bridge leads from a source's form, joints, chunk, rate or range to the target's.
CONTRACT_MISMATCH     runtime_contract.yaml expects another period, step, rate or mode than the target has.
LIMIT_INVALID         A limit of safety.yaml is too narrow, wider than the target's, or unenforceable.
NOT_OBSERVED          An argument, condition, fan-out or scene needs what no observation has shown.
NOT_OFFERED           Target or runtime do not offer an observation, action, operation or kind of skill.
NOT_SECURED           A target or client has no safe key, token, TLS or certificate, or others can use the sockets.
NO_DRIVER             No driver moves a target of this kind or name, or the process of its environment does not start.
OBSERVATION_MISMATCH  No sensor that is read gives a needed observation in its shape, unit, frame, modality or rate.
OUT_OF_REACH          Every grasp or place is beyond the arm's reach, or beyond the workspace of safety.yaml.
POLICY_MISMATCH       A policy, or its server, differs from its description in SKILL.md, or is too slow for its chunks.
POLICY_UNREACHABLE    No policy server answers, or it cannot be started.
PRECONDITION_UNMET    A precondition is false or unknown in the world as observed.
START_OUTSIDE         The tool stands outside the workspace, or in a keep-out volume, before anything has moved.
TARGET_MISMATCH       The live target differs from TARGETS.md.
VERSION_MISMATCH      Skill, policy, target and this software have versions that do not go together.
""",
    ("preflight", "operator", "later"): """
RESOURCE_UNAVAILABLE A resource that the session needs is held by a target that is broken.
""",
    ("planning", "agent", "replanned"): """
IN_COLLISION     The arm, or every goal posture, touches something.
LOAD_LOST        An object that was to travel on another did not arrive with it.
LOOKAHEAD_FAILED The requested look-ahead could not be carried out.
LOOKAHEAD_LOW    The predicted chance of success is too low, so nothing was moved.
NOT_GRASPABLE    The object is wider than the gripper opens, or too heavy for the arm or the fingers' friction.
NO_FREE_SITE     There is no free room at the destination.
NO_IK            No joint posture reaches the requested pose.
NO_SPACE         The destination is too small for the object.
""",
    ("execution", "agent", "replanned"): """
AGENT_GAVE_UP           The agent that directed a session ended it as failed.
ALREADY_MET             The acceptance was true before the session, so that nothing was commanded.
CALL_FAILED             A procedure of the target was rejected, aborted or cancelled, or its server is gone.
CONTACT                 A guarded motion met something, and stopped.
GRASP_LOST              The object was held and is not any more.
GRASP_MISSED            The fingers closed and do not hold the object.
LEAF_ERROR              A leaf failed by an error of its own, or what adapts a policy did.
MOTION_CONFLICT         Another robot stood in the way of a motion for too long.
NOT_AT_START            A motion does not begin where the arm stands.
OBSERVATION_UNAVAILABLE A picture or measurement is missing, old, dark, or of another form than declared.
POLICY_LOST             The policy server closed its connection, or sent nothing in time.
STALLED                 A motor does not follow its set-points, or no control period passes for longer than allowed.
STILL_HELD              The fingers opened and still hold the object.
TIMED_OUT               A time limit was reached: of the contract, of the tree, of preflight or of a queue.
UNMET                   A condition of the tree is false or unknown, or a cooldown has not passed.
""",
    ("verification", "agent", "replanned"): """
ADAPTER_REFUSED     A command did not fit the target: an adapter or the target itself refused it.
BUDGET              The budget of sessions, simulated time or an agent's calls is spent.
CONSTRAINT_VIOLATED A condition that has to hold all through does not, or did not.
EVIDENCE_MISSING    The evidence does not show whether the objective was met.
IMPOSSIBLE          This skill has no motion for this request (too short, too tall, no joint); another one may.
JUDGES_DISAGREE     One judge calls true what another calls false.
JUDGE_FAILED        A judge gave no usable answer, and nothing else is open.
MODEL_FAILED        A model or detector did not answer in time, with an error, or in another form than agreed.
NO_PLAN             No motion was found: no path in the budget, or none within the tilt limit.
OBJECT_HIDDEN       The object is believed to exist and was not seen.
OBJECT_MOVED        The object was not where it had been when the motion was planned.
PLACED_WRONG        The object was moved and is not where it was wanted.
POLICY_FAILED       The policy gave no usable action: its server reported a fault, or its answer cannot be read.
SENSOR_STALE        The latest measurement is too old to describe the world.
UNDECIDABLE         Everything was seen, and still a criterion cannot be decided.
UNKNOWN             None of the other causes.
WITHOUT_EFFECT      The robot moved, the object did not.
""",
    ("verification", "operator", "never"): """
CANCELLED           An end was requested.
CRITERIA_CONTRADICT Two criteria exclude one another, so that no world meets the contract.
NOTHING_CHANGED     No command was executed and nothing moved, although the skill reported success.
NO_CRITERIA         The contract holds nothing that could be accepted.
OBJECT_GONE         The object is not in the believed world, or a request names none.
""",
    ("safety", "agent", "replanned"): """
ABORTED             A command waited for other targets of its world, and its session was to end.
CLAMPED             A value was projected into its range, as the contract or safety.yaml declares.
COLLISION           The commanded posture would touch something.
COLLISION_STOP      The target stopped itself: a contact force was too large.
DEADMAN             No command came in time while the arm moved; the target brought itself to rest.
DISCONTINUOUS       A chunk jumps further than the target's velocity permits.
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
PROTECTIVE_STOP     The target stopped itself, a joint or the tool outside of its limits, or a person has to reset it.
RATE                Commands come faster than allowed.
ROTATION_INVALID    The columns of a rotation do not form one.
SAFETY_STOP         A safety layer stopped the execution; the commands of the session are at an end.
SESSION_TOO_LONG    The session has been commanding for longer than allowed.
SET_POINTS_DISAGREE The velocity rows are not the velocity of the position rows.
WORKSPACE           The tool centre point is outside the workspace.
WRONG_SHAPE         An array of a command has another shape or type than one control period.
""",
    ("target", "runtime", "observed"): """
LEASE_LOST      No watchdog has renewed the lease of a session that runs; the worker ended it.
MALFORMED       A message on the wire could not be read.
NO_AUTHORITY    A command came without a claim, or out of sequence.
NO_GRAPHICS     This machine cannot draw; sensors.yaml may have `backend: ray`.
PROTOCOL_BROKEN The target sent an answer to no request, or one that cannot be: time that runs backwards.
REQUEST_INVALID A request comes before an episode began, or names no such camera, tool, truth, model or window.
RUNNER_LOST     The worker or its planner ended, sent no heartbeats or conflicting ones, or broke its protocol.
STALE_TOKEN     A command came under a claim that is no longer in force.
TARGET_LIMIT    The target itself refused a command.
TARGET_LOST     The target does not answer any more, or its worker cannot be started.
""",
    ("target", "agent", "elsewhere"): """
HOST_LOST The host of a fleet that held the session fell silent; another one offers its target.
""",
}

# Codes of earlier releases, which documents still hold: what each is called now.
ALIASES = """
ACTION_SPACE_MISMATCH: CLAMP_UNBOUNDED GRIPPER_MISMATCH JOINT_MISSING RATE_UNBRIDGED REPRESENTATION_UNBRIDGED
ACTION_SPACE_MISMATCH: ACTION_SPACE_INVALID CHUNK_LENGTH
ALREADY_OVER: TURN_OVER NOT_LATCHED
AMBIGUOUS: ALIKE
BROKEN_PYTHON: BROKEN_BEHAVIOURS BROKEN_PREDICATES NOT_A_LEAF BROKEN_PLUGIN
BROKEN_TREE: TWO_ACTIONS UNWRITTEN_KEY UNWRITTEN_OUTPUT TREE_INVALID
BUDGET: CALLS_SPENT
BUSY: RUN_BUSY EVIDENCE_BUSY WATCHED_ALREADY JOURNAL_LOCKED EPISODE_CONFLICT TARGET_BUSY
CHANGED: PROPOSAL_OPEN PROPOSAL_DECIDED RUN_DAMAGED NOT_PAIRED CONTRADICTS_DONE GOAL_DIFFERS RUN_DIFFERS
CHANGED: PROPOSAL_CHANGED LOOK_DIFFERS SETTINGS_CHANGED
CLAMPED: CLAMPED_GRIPPER CLAMPED_JOINT
CONSTRAINT_VIOLATED: HOLD_BROKEN HOLD_VIOLATED
CYCLE: RECURSION
DUPLICATE_NAME: DUPLICATE_BLOCK DUPLICATE_KEY DUPLICATE_LEAF DUPLICATE_PLUGIN DUPLICATE_VALUE
EVIDENCE_DAMAGED: MISMATCH MISSING UNLISTED UNSEALED MANIFEST_DAMAGED LOOK_MISSING POINTER_BROKEN EVIDENCE_UNREADABLE
EXTRA_MISSING: MODULE_MISSING RAY_MISSING ENVIRONMENT_MISSING VISION_NOT_CONFIGURED API_KEY_MISSING SETUP_FAILED
IMPOSSIBLE: NO_SLIDE TOO_SHORT TOO_TALL
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
MISSING_VALUE: UNSOURCED_LIMIT REASON_MISSING NOTHING_TO_ACCEPT PARAMETER_MISSING LANE_UNCLEAR OUTPUT_MISSING
MODEL_FAILED: DETECTOR_REFUSED DETECTOR_TIMEOUT DETECTOR_UNREACHABLE MODEL_REFUSED MODEL_UNREACHABLE MODEL_MALFORMED
MODEL_FAILED: DETECTOR_FAILED DETECTOR_MALFORMED
MODEL_INVALID: MODEL_UNREADABLE NO_SERIAL_CHAIN WRONG_AXIS WRONG_OPENING
NOT_A_WORKSPACE: NOT_A_RUN NO_JOURNAL
NOT_EXECUTED: NO_SNAPSHOT NOTHING_TO_EXPORT EXECUTION_MISSING NOT_JUDGED
NOT_GRASPABLE: TOO_WIDE TOO_HEAVY TOO_SLIPPERY
NOT_OBSERVED: NEVER_SEEN ENTITY_UNKNOWN NOTHING_SEEN NOTHING_OBSERVED
NOT_OFFERED: CAPABILITY_UNAVAILABLE OPERATION_UNAVAILABLE ACTION_UNAVAILABLE SKILL_KIND_UNSUPPORTED
NOT_PERMITTED: NOT_APPROVED TOOL_NOT_OFFERED NOT_BY_HAND NOT_PROMOTED NOT_CHECKED OPERATION_FORBIDDEN RESET_FORBIDDEN
NOT_RUNNING: PLANE_ENDED RUNTIME_LOST
NOT_SECURED: NO_TOKEN NOT_ENCRYPTED NOT_TRUSTED SOCKETS_UNSAFE BAD_TOKEN
NO_AUTHORITY: OUT_OF_SEQUENCE
NO_CANDIDATE: NOT_PLANNABLE
NO_DRIVER: NO_ENVIRONMENT
NO_PLAN: NO_PATH_FOUND TILT
OBJECT_GONE: UNKNOWN_ENTITY
OBJECT_HIDDEN: NOT_VISIBLE
OBSERVATION_MISMATCH: OBSERVATION_DTYPE OBSERVATION_FRAME OBSERVATION_MODALITY OBSERVATION_RATE OBSERVATION_SHAPE
OBSERVATION_MISMATCH: OBSERVATION_UNIT SENSOR_MISSING SENSOR_MODALITY SENSOR_RATE SENSOR_UNREAD SENSOR_MISMATCH
OBSERVATION_UNAVAILABLE: CAMERA_SILENT FRAME_DROPPED
OUT_OF_REACH: OUTSIDE_WORKSPACE
POLICY_FAILED: POLICY_FAULT
POLICY_LOST: POLICY_STALLED POLICY_UNDERRUN
POLICY_MISMATCH: POLICY_TOO_SLOW POLICY_UNDECLARED
POLICY_UNREACHABLE: POLICY_MISSING
PROTECTIVE_STOP: RESET_NEEDED
REQUEST_INVALID: NO_SCENE NO_STATE UNKNOWN_CAMERA UNKNOWN_TOOL INVALID_CROP NO_GROUND_TRUTH NO_MODEL NO_EPISODE
RUNNER_LOST: HEARTBEAT_LOST HEARTBEAT_INCONSISTENT PLANNER_LOST SESSION_LOST
SAFETY_STOP: DRIVES_OFF
SCENE_INVALID: SCENE_OVERFULL WRONG_SCALE NOT_ALIKE UNSUPPORTED OVERLAP
STALLED: NO_PROGRESS
SYNTAX: PREDICATE_SYNTAX XML_SYNTAX YAML_SYNTAX UNCLOSED_FENCE
TARGET_LOST: TARGET_UNAVAILABLE
TIMED_OUT: PREFLIGHT_TIMED_OUT QUEUE_TIMED_OUT OUT_OF_TIME
TOO_LARGE: TOO_MANY_PROPOSALS CONTEXT_TOO_LARGE RECORD_TOO_LARGE
UNKNOWN_NAME: UNKNOWN_FORECASTER UNKNOWN_JUDGE UNKNOWN_BLOCK UNKNOWN_KEY UNKNOWN_LEAF UNKNOWN_NOISE_LEVEL UNKNOWN_NODE
UNKNOWN_NAME: UNKNOWN_OUTPUT UNKNOWN_PARAMETER UNKNOWN_PLUGIN UNKNOWN_PORT UNKNOWN_POSTURE UNKNOWN_PREDICATE
UNKNOWN_NAME: UNKNOWN_REPAIR UNKNOWN_REFERENCE UNKNOWN_SCENE UNKNOWN_SCORER UNKNOWN_SENSOR UNKNOWN_SKILL
UNKNOWN_NAME: UNKNOWN_TARGET UNKNOWN_TREE UNKNOWN_WORD UNKNOWN_CODE UNKNOWN_ENTRY UNKNOWN_FILE UNKNOWN_FOLDER
UNKNOWN_NAME: UNKNOWN_GOAL UNKNOWN_REQUEST UNKNOWN_SCHEMA UNKNOWN_SESSION UNKNOWN_PROPOSAL UNKNOWN_RESOURCE
UNKNOWN_NAME: UNKNOWN_DETECTOR FRAME_UNKNOWN JOINT_UNKNOWN PARAMETER_UNKNOWN RESOURCE_UNDECLARED TARGET_UNKNOWN
UNKNOWN_NAME: UNKNOWN_MATERIAL UNKNOWN_AREA UNKNOWN_BODY UNKNOWN_JOINT UNKNOWN_SITE UNKNOWN_GEOM
UNMET: COOLING_DOWN
UNREADABLE_FILE: MODEL_MISSING JOURNAL_UNREADABLE
WORLD_CONFLICT: WORLD_DIFFERS WORLD_NOT_SHARED WORLD_SHARED PERIODS_DIFFER TARGET_IN_TWO_WORLDS
WRITE_FAILED: JOURNAL_CLOSED JOURNAL_MOVED JOURNAL_WRITE_FAILED EVIDENCE_UNWRITABLE LATCH_UNWRITABLE LOG_UNWRITABLE
"""
