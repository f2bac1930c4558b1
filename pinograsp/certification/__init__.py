"""Certification of given grasps: which hold, how hard they must press, and why the others do not hold."""

from pinograsp.certification.certify import Certifier, certify
from pinograsp.certification.commands import Commands
from pinograsp.certification.protocols import PROTOCOLS, Protocol
from pinograsp.certification.record import Certificates, decisive_hint, placement_hint
from pinograsp.certification.trial import make_trial

__all__ = [
    "PROTOCOLS",
    "Certificates",
    "Certifier",
    "Commands",
    "Protocol",
    "certify",
    "decisive_hint",
    "make_trial",
    "placement_hint",
]
