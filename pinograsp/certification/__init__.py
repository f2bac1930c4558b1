"""Grasps that others made: which hold, how hard they must press, and why the others do not hold."""

from pinograsp.certification.certify import Certifier, certify
from pinograsp.certification.record import Certificates, placement_hint
from pinograsp.certification.trial import make_trial

__all__ = ["Certificates", "Certifier", "certify", "make_trial", "placement_hint"]
