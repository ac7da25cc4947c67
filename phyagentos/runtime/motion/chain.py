"""Forward kinematics of a tree of joints, those of a base first, and a fast inverse, compiled by numba.

The inverse screens goal postures and follows straight lines of the tool roughly; mink solves both (`kinematics`). No
`fastmath`: the same bits on every machine with the same mathematical library.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.geometry import compute_inverse, make_matrix
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.robot_model import RobotModel

LIMIT_MARGIN_RAD = 0.02  # a posture at a joint limit leaves no room for a correction
REACHED = 1e-4, 1e-3  # [m], [rad] of a tool pose: less than a tenth of what perception errs
STEPS = 60  # of the inverse, at most
STALL_STEPS, STALL_SHARE = 8, 0.8  # given up where so many steps leave more than this share of the error
JUMP_MAX_RAD = 0.35  # a larger step between neighbours on a line is another branch of the inverse


@dataclass(frozen=True, slots=True)
class Chain:
    """Kinematics of a tree of joints; link 0 is the base, link i turns about its own z axis by joint i.

    Attributes:
        frames: (n_joints + 1, 3, 4) `parent_T_link(i)` at joint angle zero; row 0 is `world_T_base`.
        parents: (n_joints + 1,) the link that carries each, an earlier one; i - 1 in a serial arm.
        tool: The link that carries the tool centre point; the last one of a serial arm, 0 on the palm of a hand.
        tcp: (3, 4) `tool_link_T_tcp`.
        q_min_rad: (n_joints,) lower limits less a margin; `q_max_rad` likewise.
        link_of_body: Link index by body id of the robot's model.
        zero: (n_joints + 1, 4, 4) `world_T_link` at joint angles zero.
        slides: So many of the first joints slide along that axis instead: those of a base that moves.
    """

    frames: Array
    parents: NDArray[np.int64]
    tool: int
    tcp: Array
    q_min_rad: Array
    q_max_rad: Array
    link_of_body: dict[int, int]
    zero: Array
    slides: int

    def compute_tcp(self, q_rad: Array) -> Array:
        """`world_T_tcp` (4, 4) of a posture (n_joints,)."""
        T: Array = self.compute_tcp_path(np.asarray(q_rad)[None])[0]
        return T

    def compute_tcp_path(self, path_rad: Array) -> Array:
        """`world_T_tcp` (k, 4, 4) of postures (k, n_joints)."""
        carrier = np.empty((len(path_rad), 3, 4))
        rows = np.ascontiguousarray(path_rad, dtype=np.float64)
        _compute_tool_links(rows, self.frames, self.parents, self.slides, self.tool, carrier)
        T = np.tile(np.eye(4), (len(path_rad), 1, 1))
        T[:, :3] = carrier[:, :, :3] @ self.tcp
        T[:, :3, 3] += carrier[:, :, 3]
        return T

    def solve(self, world_T_tcp: Array, start_rad: Array) -> Array | None:
        """A posture within 1e-4 m and 1e-3 rad of a tool pose, found from `start_rad`, or None."""
        rows, _ = self.solve_all(world_T_tcp, np.asarray(start_rad, dtype=np.float64)[None], 0.0)
        return rows[0] if len(rows) else None

    def solve_all(self, world_T_tcp: Array, starts_rad: Array, apart_rad: float) -> tuple[Array, int]:
        """Postures (m, n_joints) that starts (k, n_joints) lead to, of which a joint differs by `apart_rad` or more.

        Also returns how many starts led to one, like it or not.
        """
        rows = np.empty_like(starts := np.ascontiguousarray(starts_rad))
        target = np.ascontiguousarray(world_T_tcp[None, :3])
        count, reached = _solve_each(starts, target, apart_rad, rows, False, *self._tree)
        return rows[:count], reached

    def follow(self, poses: Array, start_rad: Array) -> Array | None:
        """Postures (k, n_joints) at tool poses (k, 4, 4) of a line, of which `start_rad` is the first.

        None where a pose is out of reach or on another branch.
        """
        rows = np.empty((len(poses), len(start_rad)))
        rows[0] = start_rad
        count, _ = _solve_each(rows, np.ascontiguousarray(poses[:, :3]), 0.0, rows, True, *self._tree)
        return rows if count == len(rows) else None

    @property
    def _tree(self) -> tuple[Array, NDArray[np.int64], int, int, Array, Array, Array]:
        return self.frames, self.parents, self.slides, self.tool, self.tcp, self.q_min_rad, self.q_max_rad


def build_chain(robot: RobotModel) -> Chain:
    """Read the chain from the robot's compiled model."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    zero, link_of_body = [np.eye(4)], {0: 0}
    for joint in range(model.njnt):
        zero.append(
            make_matrix(
                rotation=data.xmat[model.jnt_bodyid[joint]].reshape(3, 3) @ _align_z_with(model.jnt_axis[joint]),
                position_m=data.xanchor[joint],
            )
        )
        link_of_body[int(model.body_weldid[model.jnt_bodyid[joint]])] = joint + 1
    bodies = model.jnt_bodyid.tolist()
    parents = [  # a body's further joints follow its first one
        joint if body in bodies[:joint] else link_of_body[int(model.body_weldid[model.body_parentid[body]])]
        for joint, body in enumerate(bodies)
    ]
    frames = [zero[0], *(compute_inverse(zero[a]) @ b for a, b in zip(parents, zero[1:], strict=True))]
    site = model.site(robot.profile.tcp).id
    tool = link_of_body[int(model.body_weldid[model.site_bodyid[site]])]
    world_T_tcp = make_matrix(data.site_xmat[site].reshape(3, 3), data.site_xpos[site])
    return Chain(
        frames=np.ascontiguousarray(np.array(frames)[:, :3]),
        parents=np.array([0, *parents], dtype=np.int64),
        tool=tool,
        tcp=np.ascontiguousarray((compute_inverse(zero[tool]) @ world_T_tcp)[:3]),
        q_min_rad=robot.q_min_rad + LIMIT_MARGIN_RAD,
        q_max_rad=robot.q_max_rad - LIMIT_MARGIN_RAD,
        link_of_body={body: link_of_body[int(model.body_weldid[body])] for body in range(model.nbody)},
        zero=np.array(zero),
        slides=int((model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).sum()),
    )


def _align_z_with(axis: Array) -> Array:
    """The smallest rotation (3, 3) that turns the z axis into `axis`."""
    a = np.array(axis) / np.linalg.norm(axis)
    if a[2] < -1.0 + 1e-12:
        return np.diag((1.0, -1.0, -1.0))
    x, y, z = a
    K = np.array(((0.0, 0.0, x), (0.0, 0.0, y), (-x, -y, 0.0)))
    R: Array = np.eye(3) + K + K @ K / (1.0 + z)
    return R


@njit(cache=True, nogil=True, error_model="numpy")
def compute_links(q, frames, parents, slides, links):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201 - compiled
    """Write `world_T_link` (n_joints + 1, 3, 4) of the posture `q` into `links`; the first `slides` joints slide."""
    for r in range(3):
        for k in range(4):
            links[0, r, k] = frames[0, r, k]
    for i in range(1, frames.shape[0]):
        turn, p = 0.0 if i <= slides else q[i - 1], parents[i]
        c, s = np.cos(turn), np.sin(turn)
        for r in range(3):
            a, b, d = links[p, r, 0], links[p, r, 1], links[p, r, 2]
            x = a * frames[i, 0, 0] + b * frames[i, 1, 0] + d * frames[i, 2, 0]
            y = a * frames[i, 0, 1] + b * frames[i, 1, 1] + d * frames[i, 2, 1]
            links[i, r, 0] = c * x + s * y
            links[i, r, 1] = c * y - s * x
            links[i, r, 2] = a * frames[i, 0, 2] + b * frames[i, 1, 2] + d * frames[i, 2, 2]
            links[i, r, 3] = a * frames[i, 0, 3] + b * frames[i, 1, 3] + d * frames[i, 2, 3] + links[p, r, 3]
            if i <= slides:
                links[i, r, 3] += links[i, r, 2] * q[i - 1]


@njit(cache=True, nogil=True, error_model="numpy")
def copy_row(row, place):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Write `row` (n,) into `place`; an assignment to a slice compiles its errors' messages, which takes seconds."""
    for i in range(len(row)):
        place[i] = row[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_largest_step(one, other):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Of a joint between two postures; `np.abs(one - other).max()` takes half a second to compile."""
    largest = 0.0
    for i in range(len(one)):
        largest = max(largest, abs(one[i] - other[i]))
    return largest


@njit(cache=True, nogil=True, error_model="numpy")
def _compute_tool_links(path, frames, parents, slides, tool, carrier):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Write `world_T_link` (k, 3, 4) of the link with the tool in each posture of a path into `carrier`."""
    links = np.empty_like(frames)
    for k in range(len(path)):
        compute_links(path[k], frames, parents, slides, links)
        for r in range(3):
            copy_row(links[tool, r], carrier[k, r])


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_each(starts, poses, apart, rows, is_line, frames, parents, slides, tool, tcp, q_min, q_max):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """How many `rows` were written, and how many starts led to the pose; one kernel, since each compiles `_solve` anew.

    Without a line, every start leads to the only pose, and rows are those that differ. On a line there is a pose for
    each row, of which the first is known; the rows before it go on at an even pace to its start.
    """
    count, reached, start = 1 if is_line else 0, 0, np.zeros(rows.shape[1])
    for i in range(count, len(rows)):
        for j in range(len(start)):
            onward = rows[0, j] if i == 1 else 2.0 * rows[i - 1, j] - rows[i - 2, j]
            start[j] = min(q_max[j], max(q_min[j], onward)) if is_line else starts[i, j]
        q, is_reached = _solve(start, poses[i if is_line else 0], frames, parents, slides, tool, tcp, q_min, q_max)
        if is_line and (not is_reached or _find_largest_step(q, rows[i - 1]) > JUMP_MAX_RAD):
            break
        reached += 1 if is_reached else 0
        is_new = is_reached
        for k in range(0 if is_line else count):
            is_new = is_new and _find_largest_step(q, rows[k]) >= apart
        if is_new:
            copy_row(q, rows[count])
            count += 1
    return count, reached


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(start, target, frames, parents, slides, tool, tcp, q_min, q_max):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Damped least squares, dq = J^T (J J^T + lambda I)^-1 e, clamped to the limits, until `REACHED` or a stall."""
    n = start.shape[0]
    links, T = np.zeros(frames.shape), np.zeros((3, 4))
    J, H, e = np.zeros((6, n)), np.zeros((6, 6)), np.zeros(6)
    q, before = start.copy(), np.inf
    for step in range(STEPS + 1):
        compute_links(q, frames, parents, slides, links)
        for r in range(3):
            for c in range(4):
                T[r, c] = links[tool, r, 0] * tcp[0, c] + links[tool, r, 1] * tcp[1, c] + links[tool, r, 2] * tcp[2, c]
            T[r, 3] += links[tool, r, 3]
        position_error, rotation_error = _compute_error(target, T, e)
        if position_error < REACHED[0] and rotation_error < REACHED[1]:
            return q, True
        if step % STALL_STEPS == 0:
            if position_error + rotation_error > STALL_SHARE * before:
                break
            before = position_error + rotation_error
        _compute_jacobian(T, links, parents, slides, tool, J)
        damping = 1e-4 + 1e-2 * min(1.0, position_error**2 + rotation_error**2)
        for r in range(6):
            for c in range(r + 1):
                total = damping if r == c else 0.0
                for i in range(n):
                    total += J[r, i] * J[c, i]
                H[r, c] = total
        _solve_cholesky(H, e)
        largest = 0.0
        for i in range(n):
            by = 0.0
            for r in range(6):
                by += J[r, i] * e[r]
            J[0, i] = by
            largest = max(largest, abs(by))
        scale = 1.0 if largest < 0.5 else 0.5 / largest
        for i in range(n):
            q[i] = min(q_max[i], max(q_min[i], q[i] + scale * J[0, i]))
    return q, False


@njit(cache=True, nogil=True, error_model="numpy")
def _compute_jacobian(T, links, parents, slides, tool, J):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Write the Jacobian (6, n_joints) of the tool centre point at `T`, in the frame of the world, into `J`."""
    J[:] = 0.0
    link = tool
    while link > 0:  # the joints that carry the tool
        i, L = link - 1, links[link]
        link = parents[link]
        dx, dy, dz = T[0, 3] - L[0, 3], T[1, 3] - L[1, 3], T[2, 3] - L[2, 3]
        J[0, i] = L[1, 2] * dz - L[2, 2] * dy
        J[1, i] = L[2, 2] * dx - L[0, 2] * dz
        J[2, i] = L[0, 2] * dy - L[1, 2] * dx
        J[3, i], J[4, i], J[5, i] = L[0, 2], L[1, 2], L[2, 2]
        if i < slides:
            for r in range(3):
                J[r, i], J[r + 3, i] = L[r, 2], 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _compute_error(target, T, e):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Write the world-frame twist from `T` to `target` (6,) into `e`; return its two magnitudes."""
    R = np.zeros((3, 3))
    for r in range(3):
        e[r] = target[r, 3] - T[r, 3]
        for c in range(3):
            R[r, c] = target[r, 0] * T[c, 0] + target[r, 1] * T[c, 1] + target[r, 2] * T[c, 2]
    angle = np.arccos(min(1.0, max(-1.0, (R[0, 0] + R[1, 1] + R[2, 2] - 1.0) / 2.0)))
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = np.sqrt(x * x + y * y + z * z)
    factor = angle / sine if sine > 1e-9 else 0.5
    e[3], e[4], e[5] = factor * x, factor * y, factor * z
    return np.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2), np.sqrt(e[3] ** 2 + e[4] ** 2 + e[5] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_cholesky(H, e):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Solve H x = e in place; H (6, 6) is positive definite, its lower triangle is overwritten."""
    for j in range(6):
        for k in range(j):
            H[j, j] -= H[j, k] ** 2
        H[j, j] = np.sqrt(H[j, j])
        for i in range(j + 1, 6):
            for k in range(j):
                H[i, j] -= H[i, k] * H[j, k]
            H[i, j] /= H[j, j]
    for i in range(6):
        for k in range(i):
            e[i] -= H[i, k] * e[k]
        e[i] /= H[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            e[i] -= H[k, i] * e[k]
        e[i] /= H[i, i]
