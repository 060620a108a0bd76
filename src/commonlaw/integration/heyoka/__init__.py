"""The back end of the library heyoka: Taylor series, compiled (Biscani and Izzo 2021)."""

from commonlaw.integration.heyoka.integrator import HeyokaIntegrator
from commonlaw.integration.heyoka.translation import UnsupportedError

__all__ = ["HeyokaIntegrator", "UnsupportedError"]
