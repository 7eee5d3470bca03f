"""Fluid memory of first order."""

import sympy as sm

from undertow.model.effect import DIAGONAL, VELOCITY, DerivativeMatrix, Parameter, Signals, Wrench


class RadiationMemory(Wrench):
    """Force from the flow caused by earlier motion, with one exponential kernel for each motion.

    The convolution of the velocity with exp(-t/T_memory) is carried by one state for each motion. In Cummins'
    equation it comes on top of the added mass at infinite frequency, which no body in water is without.
    """

    id = "radiation_memory"
    family = "memory"
    reference = "Cummins (1962) impulse-response equation with a one-state kernel; Fossen (2021), chapter 5"
    requires = ("added_mass",)
    signature = "after a stop or a reversal the force depends on how the vehicle moved before"
    coefficients = DerivativeMatrix(
        "{F}_mem{m}", ("m", "rad"), DIAGONAL, "{force} per remembered {motion} displacement"
    )
    T_memory = Parameter.with_starts("s", "time constant of the memory", (0.05, 200.0), (0.5, 2.0, 8.0))

    states = tuple(f"memory_{v}" for v in VELOCITY)
    state_units = ("m",) * 3 + ("rad",) * 3

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * self.state_symbols

    def rates(self, s: Signals) -> sm.Matrix:
        return s.nu_r - self.state_symbols / self.T_memory
