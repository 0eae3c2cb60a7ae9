"""The drive a third time, for tests: two hinges and a limited tendon in MuJoCo, moved by a torque at the motor.

Imported only where MuJoCo is installed. The gap is constant and the current imposed: MuJoCo has neither a varying gap
nor a winding.
"""

import mujoco
import numpy as np

from backlash_ros.drivetrain import Drive

STEP = 5e-5
"""s"""
STANDARD_GRAVITY = 9.81
"""m/s^2"""
LIMIT_TIME = 20 * STEP
"""Time constant of the tendon's limit, s: MuJoCo's solref."""
LIMIT_IMPEDANCE = 0.99
"""MuJoCo's solimp of the tendon's limit."""
FRICTION_IMPEDANCE = 0.9999
"""MuJoCo's solimp of dry friction: its largest."""

# Friction stops a shaft as fast as MuJoCo lets it: a time constant of two steps. Contact between bodies has no part.
MODEL = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="{standard_gravity} 0 0" tolerance="1e-14" iterations="50">
    <flag contact="disable"/>
  </option>
  <default>
    <joint type="hinge" axis="0 0 1" solreffriction="{friction_time} 1"
      solimpfriction="{friction_impedance} {friction_impedance} 1"/>
  </default>
  <worldbody>
    <body>
      <joint name="motor" damping="{motor.viscous_friction}" frictionloss="{motor.coulomb_friction}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{motor.inertia} {motor.inertia} {motor.inertia}"/>
    </body>
    <body euler="0 0 {load.gravity_offset}">
      <joint name="load" damping="{load.viscous_friction}" frictionloss="{load.coulomb_friction}"/>
      <inertial pos="{arm} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    </body>
  </worldbody>
  <tendon>
    <fixed limited="true" range="-{half_gap} {half_gap}" solreflimit="{limit_time} 1"
      solimplimit="{limit_impedance} {limit_impedance} 1">
      <joint joint="motor" coef="{gear.ratio}"/>
      <joint joint="load" coef="-1"/>
    </fixed>
  </tendon>
</mujoco>
"""


class MujocoDrive:
    """A drive in MuJoCo, started at theta_m, omega_m, theta_l, omega_l."""

    def __init__(self, drive: Drive, start: list[float]) -> None:
        load, gear = drive.load, drive.gear
        assert drive.takes_current
        assert gear.backlash_variation == 0.0
        assert gear.efficiency_forward == gear.efficiency_backward == 1.0
        # A weight that hangs on an arm, on which it has half of the load's inertia.
        arm, mass = 0.0, 1.0
        if load.gravity_torque:
            arm = 0.5 * load.inertia * STANDARD_GRAVITY / load.gravity_torque
            mass = load.gravity_torque / (STANDARD_GRAVITY * arm)
        text = MODEL.format(
            step=STEP,
            standard_gravity=STANDARD_GRAVITY,
            friction_time=2 * STEP,
            friction_impedance=FRICTION_IMPEDANCE,
            limit_time=LIMIT_TIME,
            limit_impedance=LIMIT_IMPEDANCE,
            motor=drive.motor,
            load=load,
            gear=gear,
            arm=arm,
            mass=mass,
            inertia=load.inertia - mass * arm**2,
            half_gap=0.5 * gear.backlash_angle,
        )
        # The angle of the weight is in radians, like ours.
        text = text.replace("<option", '<compiler angle="radian"/>\n  <option', 1)
        self.drive = drive
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:], self._data.qvel[:] = start[0::2], start[1::2]

    def advance(self, current: float, load_torque: float, steps: int) -> None:
        """Advance by a number of steps under a constant current (A) and load torque (N m)."""
        self._data.qfrc_applied[:] = self.drive.motor.torque_constant * current, load_torque
        mujoco.mj_step(self._model, self._data, steps)

    @property
    def state(self) -> np.ndarray:
        """theta_m, omega_m, theta_l, omega_l."""
        (theta_m, theta_l), (omega_m, omega_l) = self._data.qpos, self._data.qvel
        return np.array([theta_m, omega_m, theta_l, omega_l])


def limit_give(drive: Drive, torque: float) -> float:
    """Return how far beyond the gap the tendon's limit carries a torque on the output shaft (N m), rad there.

    From the chapter on solver parameters in MuJoCo's documentation: at rest R f = k r, with R = (1 - d)/d A and
    k = 1/(d timeconst)^2, A the acceleration of the gap for each newton metre.
    """
    per_torque = 1.0 / drive.reflected_inertia + 1.0 / drive.load.inertia
    return (1.0 - LIMIT_IMPEDANCE) * LIMIT_IMPEDANCE * LIMIT_TIME**2 * per_torque * torque


def friction_creep(torque: float, inertia: float) -> float:
    """Return how fast a shaft creeps that MuJoCo's dry friction holds against a torque (N m), rad/s.

    From the same chapter: R f = b v, with b = 2/(d timeconst) and R as there.
    """
    return (1.0 - FRICTION_IMPEDANCE) * STEP * torque / inertia
