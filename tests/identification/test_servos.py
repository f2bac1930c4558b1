"""Stiffness of servos: of duties that are made, and of published figures."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pinograsp.errors import InvalidInput
from pinograsp.hands import load_hand
from pinograsp.identification import Motor, identify_servo_stiffness, read_bam, read_duty


def test_stiffness_is_the_slope_of_the_duty_beyond_what_makes_up_for_friction():
    errors = np.linspace(0.003, 0.15, 60)
    duties = 0.165 + 3e-4 / errors  # duty per error, of a constant and a slope
    motors = [Motor(torque_constant=k, resistance=5.5) for k in (2.0, 2.5, 3.0)]
    found = identify_servo_stiffness(errors, duties, motors, voltage=12.0, gain=32)
    assert found == pytest.approx([k * 12 / 5.5 * 0.165 * 32 for k in (2.5, 2.0, 3.0)])
    # K-Scale Labs' STS3215 at 12 V: the catalogue's gripper with LeRobot's P of 16, and at 7.4 V (Rhoban's BAM).
    half = identify_servo_stiffness(errors, duties, motors, voltage=12.0, gain=16).value
    assert load_hand("so101").drives[0].stiffness == pytest.approx(half, rel=0.02)
    assert identify_servo_stiffness(errors, duties, motors, voltage=7.4, gain=16).value == pytest.approx(8.9, rel=0.02)


def test_files_of_motors_and_duties(tmp_path):
    (tmp_path / "m.json").write_text(json.dumps({"kt": 2.5, "R": 5.5, "friction_viscous": 0.04, "model": "m1"}))
    motor = read_bam(tmp_path / "m.json")
    assert motor.damping() == pytest.approx(2.5**2 / 5.5 + 0.04) and motor.friction is None
    (tmp_path / "d.csv").write_text("\ufeffpos_err,error_gain\n0.1,0.2\n0.2,0.18\n0.3,0.17\n")
    assert [values.tolist() for values in read_duty(tmp_path / "d.csv")] == [[0.1, 0.2, 0.3], [0.2, 0.18, 0.17]]
    for content in ("", "{}", "[", '{"kt": -1, "R": 2}', '{"kt": "x", "R": 2}'):
        (tmp_path / "m.json").write_text(content)
        with pytest.raises(InvalidInput):
            read_bam(tmp_path / "m.json")
    (tmp_path / "d.csv").write_text("a,b\n1,x\n")
    with pytest.raises(InvalidInput):
        read_duty(tmp_path / "d.csv")
    with pytest.raises(InvalidInput):
        identify_servo_stiffness([0.1, 0.2, 0.3], [0.2, 0.2, 0.2], [], voltage=12, gain=16)
