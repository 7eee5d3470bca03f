"""What `import undertow` gives of code generation: a model that runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.notebook import html

from .functions import Functions
from .simulate import Simulator


class Model:
    """A vehicle whose equations are ready to run.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._functions = Functions(vehicle)
        self._simulator = Simulator(self._functions)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: pose, velocities, then those that effects own."""
        return self._functions.state_names

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.vehicle.command_names

    def simulate(self, x0: ArrayLike, u: ArrayLike, dt: float) -> NDArray[np.float64]:
        """Simulate with inputs that are held between samples (zero-order hold).

        Parameters
        ----------
        x0 : array_like, shape (nx,)
            State at the start, SI, in the order of `states`.
        u : array_like, shape (n, nu)
            Inputs; u[i] holds from i dt to (i + 1) dt.
        dt : float
            Time between samples, s.

        Returns
        -------
        ndarray, shape (n, nx)
            States at the samples, the first of them x0; NaN from where the motion diverges.

        Raises
        ------
        UndertowError
            If a shape does not fit, or dt is not positive.
        """
        if not (np.isfinite(dt) and dt > 0):
            raise UndertowError(f"dt = {dt:g} s is no time between samples: give a positive one")
        inputs = np.asarray(u, dtype=float)
        p = np.array(self._functions.values(), dtype=float)
        return self._simulator.run(np.asarray(x0, dtype=float), dt * np.arange(float(len(inputs))), inputs, p)

    def __repr__(self) -> str:
        return (
            f"Model of {self.vehicle.name}: states {', '.join(self.states)}; inputs {', '.join(self.inputs)}"
        )

    def _repr_html_(self) -> str:
        return html(repr(self))


def compile(vehicle: Vehicle) -> Model:
    """Compile the equations of a vehicle, where there is a C compiler.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.

    Returns
    -------
    Model
        `states`, `inputs` and `simulate(x0, u, dt)`.

    Raises
    ------
    UndertowError
        If the compiler fails.

    Examples
    --------
    >>> import numpy as np
    >>> import undertow as ut
    >>> model = ut.compile(ut.load_vehicle("mini-auv"))
    >>> x = model.simulate(np.zeros(len(model.states)), np.zeros((11, len(model.inputs))), dt=0.1)
    >>> x.shape == (11, len(model.states))
    True
    """
    return Model(vehicle)
