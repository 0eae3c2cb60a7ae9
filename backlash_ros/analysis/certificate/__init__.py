"""The certificate of a drive: what a recording tells of it, on one page that a browser opens and a printer prints."""

from backlash_ros.analysis.certificate.page import certificate
from backlash_ros.analysis.certificate.subject import Subject

__all__ = ["Subject", "certificate"]
