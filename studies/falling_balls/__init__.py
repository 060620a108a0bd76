"""The founding paper, redone: de Silva, Higdon, Brunton, Kutz, "Discovery of Physics from Data" (2020)."""

from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.study import inquire, run

__all__ = ["Inquiry", "inquire", "run"]
