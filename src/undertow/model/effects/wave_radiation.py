"""Fluid memory of second order: the waves that a vessel has sent out."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, VELOCITY, DerivativeMatrix, Parameter, Signals, Wrench, column

_FREQUENCIES = column([f"omega_rad_{v}" for v in VELOCITY])
_TIMES = column([f"T_rad_{v}" for v in VELOCITY])


def _frequency(motion: str) -> Parameter:
    return _of_kernel("rad/s", f"frequency at which {motion} radiates the largest waves")


def _time(motion: str) -> Parameter:
    return _of_kernel("s", f"decay time of the memory of {motion}")


def _of_kernel(unit: str, meaning: str) -> Parameter:
    return Parameter.with_default(unit, meaning, (1e-3, 200.0), 1.0)


class WaveRadiation(Wrench):
    """Force of waves radiated earlier by a hull at the surface, an oscillating kernel for each motion.

    Beside `radiation_memory`, of one state for each motion, because slow motion makes no waves: radiation
    damping is zero at zero frequency, which one state cannot give. Two states can: the damping is that of a
    resonance, X_radu (w^2 / T) / ((omega^2 - w^2)^2 + (w / T)^2) at the frequency w in surge, and never
    feeds power into the vessel. The added mass beside it is that of infinite frequency.
    """

    id = "wave_radiation"
    family = "memory"
    of_shape = True
    reference = (
        "Cummins (1962) impulse-response equation; Perez and Fossen (2008), time- vs. frequency-domain "
        "identification of parametric radiation force models, for what a kernel of it has to fulfil"
    )
    signature = "damping and added mass change with the frequency of the motion"

    coefficients = DerivativeMatrix(
        "{F}_rad{m}", ("m", "rad"), DIAGONAL, "{force} per remembered {motion} displacement", bounds=(-inf, 0)
    )
    omega_rad_u, omega_rad_v, omega_rad_w = _frequency("surge"), _frequency("sway"), _frequency("heave")
    omega_rad_p, omega_rad_q, omega_rad_r = _frequency("roll"), _frequency("pitch"), _frequency("yaw")
    T_rad_u, T_rad_v, T_rad_w = _time("surge"), _time("sway"), _time("heave")
    T_rad_p, T_rad_q, T_rad_r = _time("roll"), _time("pitch"), _time("yaw")

    states = (*(f"radiated_{v}" for v in VELOCITY), *(f"returned_{v}" for v in VELOCITY))
    state_units = (("m",) * 3 + ("rad",) * 3) * 2

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * self.state_symbols[:6, :]

    def rates(self, s: Signals) -> sm.Matrix:
        out, back = self.state_symbols[:6, :], self.state_symbols[6:, :]
        swing = _FREQUENCIES.multiply_elementwise(back)
        fading = out.multiply_elementwise(_TIMES.applyfunc(lambda T: 1 / T))
        return sm.Matrix.vstack(s.nu - fading - swing, _FREQUENCIES.multiply_elementwise(out))
