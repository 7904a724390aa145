"""The yardstick: closed-chain inverse dynamics as one would write it with Pinocchio, sample by sample.

Nothing is made slow on purpose: frame indices, data and selection matrices are looked up once, Newton starts from the
previous sample, and the planar rows are sliced from Pinocchio's frame Jacobians.
"""

import numpy as np
import pinocchio as pin

import redundancy_pin as rp

AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class PlainLoop:
    """Inverse dynamics of the 3-RRR by a loop of Pinocchio calls."""

    def __init__(self, robot):
        model = self.model = robot.model
        self.data = model.createData()
        self.pairs = [(model.getFrameId(c.frame_a), model.getFrameId(c.frame_b)) for c in robot.closures]
        self.platform = model.getFrameId(robot.platform.frame)
        self.carriers = np.array(robot.carrier_velocity)
        self.columns = np.setdiff1d(np.arange(model.nv), self.carriers)
        self.actuated = np.array(robot.actuated_velocity)
        self.selection = np.zeros((model.nv, robot.m))
        self.selection[self.actuated, np.arange(robot.m)] = 1.0
        self.carrier_selection = np.zeros((model.nv, robot.k))
        self.carrier_selection[self.carriers, np.arange(robot.k)] = 1.0
        self.q0 = np.array(robot.q_reference)

    def constraint_jacobian(self):
        def planar_rows(frame):
            return pin.getFrameJacobian(self.model, self.data, frame, AXES)[:2]

        return np.concatenate([planar_rows(b) - planar_rows(a) for a, b in self.pairs])

    def close(self, q, x):
        """Newton on closures and platform pose; returns q and the last square matrix."""
        for _ in range(20):
            pin.computeJointJacobians(self.model, self.data, q)
            pin.updateFramePlacements(self.model, self.data)
            gaps = [self.data.oMf[b].translation[:2] - self.data.oMf[a].translation[:2] for a, b in self.pairs]
            pose = self.data.oMf[self.platform]
            angle = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
            error = np.array([x[0] - pose.translation[0], x[1] - pose.translation[1], x[2] - angle])
            residual = np.concatenate([-gaps[0], -gaps[1], error])
            platform = pin.getFrameJacobian(self.model, self.data, self.platform, AXES)[[0, 1, 5]]
            matrix = np.concatenate([self.constraint_jacobian(), platform])[:, self.columns]
            if np.abs(residual).max() < 1e-12:
                return q, matrix
            step = np.zeros(self.model.nv)
            step[self.columns] = np.linalg.solve(matrix, residual)
            q = q + step
        raise RuntimeError("Newton did not converge")

    def accelerations(self, q, v, matrix, xdd):
        pin.forwardKinematics(self.model, self.data, q, v, np.zeros(self.model.nv))
        drift = [
            (
                pin.getFrameClassicalAcceleration(self.model, self.data, b, AXES).linear
                - pin.getFrameClassicalAcceleration(self.model, self.data, a, AXES).linear
            )[:2]
            for a, b in self.pairs
        ]
        own = pin.getFrameClassicalAcceleration(self.model, self.data, self.platform, AXES)
        rate = np.concatenate([-drift[0], -drift[1], xdd - np.array([own.linear[0], own.linear[1], own.angular[2]])])
        return np.linalg.solve(matrix, rate)

    def efforts(self, q, v, a):
        """rnea, constraint Jacobian, least squares for [tau, carrier force, closure force]."""
        tree = pin.rnea(self.model, self.data, q, v, a)
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        matrix = np.concatenate([self.selection, self.carrier_selection, self.constraint_jacobian().T], axis=1)
        solution = np.linalg.lstsq(matrix, tree, rcond=None)[0]
        return solution[: self.selection.shape[1]]

    def from_platform_motion(self, motion, carriers):
        tau = np.empty((len(motion.t), self.selection.shape[1]))
        q = self.q0
        for k in range(len(motion.t)):
            q, matrix = self.close(q, motion.x[k])
            v, a = np.zeros(self.model.nv), np.zeros(self.model.nv)
            v[self.columns] = np.linalg.solve(matrix, np.concatenate([np.zeros(4), motion.xd[k]]))
            a[self.columns] = self.accelerations(q, v, matrix, motion.xdd[k])
            full = q.copy()
            full[self.carriers] = carriers.s[k]
            v[self.carriers], a[self.carriers] = carriers.sd[k], carriers.sdd[k]
            tau[k] = self.efforts(full, v, a)
        return tau

    def from_tree_motion(self, q, v, a):
        return np.array([self.efforts(q[k], v[k], a[k]) for k in range(len(q))])


def smooth_motion(samples):
    """A loop through the middle of the workspace, all three coordinates in motion, carriers on half their tracks."""
    t = np.linspace(0.0, 2.0, samples)
    w = np.pi
    centre = np.array([np.sqrt(3) / 2, 0.5, 0.0])
    size = np.array([0.2, 0.2, 0.3])
    phase = w * t[:, None] + np.array([np.pi / 2, 0.0, 0.0])
    motion = rp.PlatformMotion(
        t, centre + size * np.sin(phase), w * size * np.cos(phase), -(w**2) * size * np.sin(phase)
    )
    swing = 3.0 * t[:, None] + np.arange(3)
    return motion, rp.CarrierMotion(0.5 * np.sin(swing), 1.5 * np.cos(swing), -4.5 * np.sin(swing))
