"""The one type of linear systems: named ports, continuous or discrete time, certain or uncertain (upper LFT)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, IntArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, as_number
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import Arithmetic
from lftkit.systems.control_conversion import control_system, ports_and_matrices
from lftkit.systems.delta import Value, chosen_values, delta_response, delta_system, random_values
from lftkit.systems.matrices import checked_matrices, frequencies
from lftkit.systems.ports import Port, as_ports, names_of_ports, port_indices, total_size
from lftkit.systems.system_summary import html, lines, text
from lftkit.uncertainty.elements import ComplexParameter, Element, RealParameter, description, element_table, width

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False)
class System(Arithmetic):
    """Linear system ``F_u(M, Delta)`` with named ports.

    ``Delta = diag(value - nominal)``, an element repeated as often as it occurs; without elements it is a plain state
    space. In continuous time ``x' = A x + B u, y = C x + D u``; in discrete time x' is the state at the next tick.

    The stored matrices are those of M: the first inputs and outputs are the Delta channels, one for each entry of
    `channels`; the ports follow in their order. **Delta = 0 is the nominal system.** The operators ``+ - * @ / **``
    combine systems by position: see :class:`lftkit.systems.arithmetic.Arithmetic`.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, q + m), (q + p, n), (q + p, q + m) with q Delta channels; n may be 0. Kept as read-only
        copies.
    inputs, outputs : sequence of Port (or of (name, size))
        Sizes add up to m and p; names are unique on each side.
    name : str
        Name in messages and results.
    dt : float
        Sampling period [s]; 0: continuous time.
    channels : tuple of str
        Name of the element of each Delta channel. A matrix of dynamics takes as many channels per occurrence as the
        larger of its sizes.
    elements : tuple of RealParameter, ComplexParameter or DynamicElement
        Definitions of all the names in `channels`.

    Raises
    ------
    ValueError
        Shapes that do not fit, entries that are not finite, a port name used twice, a channel without an element, a
        period that is negative or not finite.

    Examples
    --------
    >>> mass = System([[0, 1], [0, 0]], [[0], [0.5]], [[1, 0]], [[0]], [("force", 1)], [("position", 1)], "2 kg")
    >>> mass.order, (3 * mass)["position", "force"].C.tolist()
    (2, [[3.0, 0.0]])

    A gain k in [1, 3], nominal 2, as ``y = 2 u + w`` with ``w = (k - 2) u``:

    >>> k, ports = RealParameter("k", 2.0, 1.0, 3.0), ([("u", 1)], [("y", 1)])
    >>> gain = System([], [], [], [[0.0, 1.0], [1.0, 2.0]], *ports, channels=("k",), elements=(k,))
    >>> float(gain.at({"k": 3.0}).D[0, 0])
    3.0
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    name: str = "system"
    dt: float = 0.0
    channels: tuple[str, ...] = ()
    elements: tuple[Element, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"name must be text (channels= and elements= go by keyword), got {self.name!r}")
        for side in ("inputs", "outputs"):
            object.__setattr__(self, side, as_ports(getattr(self, side), f"{self.name}, {side}"))
        for key, kind in (("channels", str), ("elements", Element)):
            value = getattr(self, key)
            if not isinstance(value, Iterable) or not all(isinstance(one, kind) for one in value):
                what = "names" if kind is str else "elements"
                raise InputError(f"{self.name}: {key} must be a sequence of {what}, got {value!r}"[:300])
            object.__setattr__(self, key, tuple(value))
        object.__setattr__(self, "dt", as_number(self.dt, f"{self.name}: dt"))
        if not (np.isfinite(self.dt) and self.dt >= 0):
            raise InputError(f"{self.name}: dt must be 0 (continuous time) or positive, got {self.dt}")
        q = len(self.channels)
        try:
            sizes = q + total_size(self.inputs), q + total_size(self.outputs)
            matrices = checked_matrices(self.A, self.B, self.C, self.D, *sizes)
            table = element_table(self.elements)
        except ValueError as error:
            raise InputError(f"{self.name}: {error}") from None
        for key, matrix in zip("ABCD", matrices):
            object.__setattr__(self, key, matrix)
        for name, count in Counter(self.channels).items():
            if name not in table:
                raise InputError(f"every Delta channel must have an element, got none for {name!r}")
            if count % width(table[name]):
                raise InputError(f"channels of {name!r} must be a multiple of {width(table[name])}, got {count}")
        used = tuple(e for e in dict.fromkeys(self.elements) if e.name in set(self.channels))
        object.__setattr__(self, "elements", used)

    def __repr__(self) -> str:
        return "\n".join(lines(self))

    def _repr_html_(self) -> str:
        return html(self)

    def summary(self) -> str:
        """Order, every port with size and unit, every element with range and occurrences, as text of several lines."""
        return text(self)

    # what it is

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def certain(self) -> bool:
        """Whether the system has no uncertain elements."""
        return not self.channels

    @property
    def matrices(self) -> Matrices:
        """(A, B, C, D) of a system without uncertain elements.

        Raises
        ------
        ValueError
            An uncertain system: its uncertainty would be lost.
        """
        self.require_certain()
        return self.A, self.B, self.C, self.D

    @property
    def lft(self) -> Matrices:
        """(A, B, C, D) of M, with the Delta channels first."""
        return self.A, self.B, self.C, self.D

    @property
    def parameters(self) -> tuple[RealParameter, ...]:
        """The real elements; see :meth:`require_real`."""
        return tuple(e for e in self.elements if isinstance(e, RealParameter))

    def require_certain(self) -> None:
        """Raise a ValueError where the system has uncertain elements."""
        if self.channels:
            names = ", ".join(e.name for e in self.elements)
            raise InputError(f"{self.name}: system must be certain (take .nominal() or .at(...)), got elements {names}")

    def require_siso(self) -> None:
        """Raise a ValueError where the system has several inputs or outputs, or elements."""
        self.require_certain()
        if self.D.shape != (1, 1):
            raise InputError(
                f"{self.name}: must have one input and one output, got {self.D.shape[1]} and {len(self.D)}"
            )

    def require_real(self) -> None:
        """Raise a ValueError where an element is complex or dynamic."""
        for e in self.elements:
            if not isinstance(e, RealParameter):
                kind = "complex" if isinstance(e, ComplexParameter) else "dynamic"
                raise InputError(f"{self.name}: elements must be real, got the {kind} element {e.name!r}")

    def require_continuous(self) -> None:
        """Raise a ValueError where the system is in discrete time."""
        if self.dt:
            raise InputError(f"{self.name}: system must be in continuous time, got sampling period {self.dt} s")

    def occurrences(self) -> dict[str, int]:
        """Number of repetitions of each element in Delta, in the order of `elements`."""
        count = Counter(self.channels)
        return {e.name: count[e.name] // width(e) for e in self.elements}

    def parameter(self, name: str) -> RealParameter:
        """Definition of a real element; a ValueError lists the existing ones."""
        element = self.element(name)
        if not isinstance(element, RealParameter):
            raise InputError(f"element {name!r} must be real, got {description(element)}")
        return element

    def element(self, name: str) -> Element:
        """Definition of an element; a ValueError lists the existing ones."""
        for element in self.elements:
            if element.name == name:
                return element
        known = ", ".join(e.name for e in self.elements)
        raise InputError(f"parameter must be one of {known or '(none)'}, got {name!r}")

    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (n,): of an uncertain system those of the nominal one."""
        return np.asarray(linalg.eigvals(self.A), dtype=complex) if self.order else np.zeros(0, dtype=complex)

    @checked
    def __call__(self, point: complex) -> Any:
        """Transfer matrix (p, m) of the nominal system at s or z; of one input and one output a number.

        Raises
        ------
        ValueError
            A point that is no finite number, or a pole.
        """
        q = len(self.channels)
        if not (isinstance(point, (complex, SupportsFloat)) and np.ndim(point) == 0 and np.isfinite(point)):
            raise InputError(f"point must be a finite number, got {point!r}"[:200])
        value = lft.response((self.A, self.B[:, q:], self.C[q:], self.D[q:, q:]), point)
        return complex(value[0, 0]) if value.shape == (1, 1) else value

    @checked
    def response(
        self, omega: ArrayLike, values: Mapping[str, Value] | None = None, *, beyond_range: bool = False
    ) -> ComplexArray:
        """Transfer matrices at frequencies [rad/s], shape (len(omega), p, m), at values of the elements.

        A value may also be complex, where :meth:`at` takes real numbers and systems only; with `beyond_range` outside
        its range or disk.
        """
        chosen = chosen_values(self.elements, values or {}, beyond_range=beyond_range)
        q, responses = len(self.channels), []
        for w in frequencies(omega):
            point = np.exp(1j * w * self.dt) if self.dt else 1j * w
            M = lft.response(self.lft, point)
            delta = delta_response(self.channels, self.elements, chosen, point)
            inner = linalg.solve(np.eye(q) - M[:q, :q] @ delta, M[:q, q:]) if q else M[:0]
            responses.append(M[q:, q:] + M[q:, :q] @ delta @ inner)
        return np.array(responses).reshape(-1, self.D.shape[0] - q, self.D.shape[1] - q)

    # members

    @checked
    def at(self, values: Mapping[str, Value] | None = None, *, beyond_range: bool = False, **named: Value) -> System:
        """The system at values of the elements (nominal where none is given), by mapping or by keyword.

        Parameters
        ----------
        values : mapping, optional
            A number for a real or complex element (real here: see :meth:`response`); a number, matrix or system for
            dynamics, whose gain is checked where it is constant.
        beyond_range : bool
            Whether real and complex values may lie outside their range or disk.

        Raises
        ------
        ValueError
            Unknown element, value outside its range, or an LFT that is not well posed at these values.
        """
        stated = {**_mapping(values, "values"), **named}
        chosen = chosen_values(self.elements, stated, beyond_range=beyond_range)
        requirement = f"the LFT must be well posed at {stated}"
        if all(isinstance(e, RealParameter) for e in self.elements):
            nominal = {e.name: e.nominal for e in self.parameters}
            delta = np.array([chosen[c] - nominal[c] for c in self.channels])
            matrices = lft.at_deviations(self.lft, delta, requirement)
        else:
            matrices = lft.at_system(self.lft, delta_system(self.channels, self.elements, chosen), requirement)
        return System(*matrices, self.inputs, self.outputs, self.name, self.dt)

    @checked
    def substituted(self, values: Mapping[str, float]) -> System:
        """The uncertain system with some real elements at values; the others stay uncertain (`usubs` in MATLAB).

        Raises
        ------
        ValueError
            As :meth:`at`; an element that is not real.

        Examples
        --------
        >>> from lftkit import as_system, real
        >>> spring = as_system(real("k", 1.0, 0.5, 2.0) * real("s", 3.0, 2.0, 4.0))
        >>> soft = spring.substituted({"k": 0.5})
        >>> [p.name for p in soft.parameters], soft.at(s=4.0).D.tolist()
        (['s'], [[2.0]])
        """
        chosen = chosen_values(self.elements, _mapping(values, "values"), beyond_range=False)
        names = [e.name for e in self.elements]
        system = self.sorted_channels(sorted(names, key=lambda name: name not in values))
        closed = [c for c in system.channels if c in values]
        delta = np.array([chosen[c] - self.parameter(c).nominal for c in closed])
        matrices = lft.at_deviations(system.lft, delta, f"the LFT must be well posed at {values}")
        elements = tuple(e for e in system.elements if e.name not in values)
        return system.with_lft(matrices, channels=system.channels[len(closed) :], elements=elements)

    def nominal(self) -> System:
        """The system at the nominal values of its elements."""
        return self.at({})

    @checked
    def sample_values(self, rng: np.random.Generator, count: int = 1) -> list[dict[str, Any]]:
        """`count` draws of all elements, independent.

        Real ones are uniform in their ranges, complex ones in their disks; dynamics are all-pass systems with a pole
        and a gain, up to the bound, that are random.

        Raises
        ------
        ValueError
            No generator of numpy, or no number of draws.
        """
        if not isinstance(rng, np.random.Generator):
            raise InputError(f"rng must be a numpy.random.Generator, got {type(rng).__name__}")
        if as_integer(count, "count") < 0:
            raise InputError(f"count must be at least 0, got {count}")
        return [
            {name: self._drawn(v) for name, v in random_values(self.elements, rng, self.dt).items()}
            for _ in range(count)
        ]

    def _drawn(self, value: Any) -> Any:
        if not isinstance(value, tuple):
            return value
        A, B, C, D = value
        return System(A, B, C, D, (Port("in", D.shape[1]),), (Port("out", D.shape[0]),), dt=self.dt)

    @checked
    def sample(self, rng: np.random.Generator, count: int = 1) -> list[System]:
        """The system at `count` random values of its elements, real and dynamic."""
        return [self.at(values) for values in self.sample_values(rng, count)]

    # parts and names

    def __getitem__(self, key: tuple[str | Sequence[str], str | Sequence[str]]) -> System:
        """Sub-system ``system[outputs, inputs]`` by port names; all states and channels stay."""
        if not isinstance(key, tuple) or len(key) != 2:
            raise InputError(f"index must be [output ports, input ports], for example P['y', 'u'], got {key!r}")
        return self.select(outputs=key[0], inputs=key[1])

    @checked
    def select(
        self, *, outputs: str | Iterable[str] | None = None, inputs: str | Iterable[str] | None = None
    ) -> System:
        """Keep the named ports, in the order given; the other inputs are zero.

        Raises
        ------
        ValueError
            Unknown port; the message lists the existing ones.
        """
        q = len(self.channels)
        keep_in, keep_out = self.inputs, self.outputs
        if inputs is not None:
            keep_in = tuple(self.input_port(n) for n in names_of_ports(inputs, "inputs"))
        if outputs is not None:
            keep_out = tuple(self.output_port(n) for n in names_of_ports(outputs, "outputs"))
        columns = np.r_[np.arange(q), q + self.input_indices(p.name for p in keep_in)]
        rows = np.r_[np.arange(q), q + self.output_indices(p.name for p in keep_out)]
        return replace(
            self,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            inputs=keep_in,
            outputs=keep_out,
        )

    @checked
    def input_indices(self, names: Iterable[str]) -> IntArray:
        """Places of the signals of the ports `names`, in the given order, among those of all inputs."""
        return port_indices(self.inputs, names, "input", self._label)

    @checked
    def output_indices(self, names: Iterable[str]) -> IntArray:
        """Places of the signals of the ports `names`, in the given order, among those of all outputs."""
        return port_indices(self.outputs, names, "output", self._label)

    @checked
    def input_port(self, name: str) -> Port:
        """Input port of this name; a ValueError lists the existing ones."""
        self.input_indices([name])
        return next(p for p in self.inputs if p.name == name)

    @checked
    def output_port(self, name: str) -> Port:
        """Output port of this name; a ValueError lists the existing ones."""
        self.output_indices([name])
        return next(p for p in self.outputs if p.name == name)

    @property
    def _label(self) -> str:
        return "" if self.name == "system" else self.name

    def named(self, name: str) -> System:
        """The same system under another name."""
        return replace(self, name=name)

    def with_lft(self, matrices: Matrices, **changes: Any) -> System:
        """The same system with other matrices of M and other fields."""
        A, B, C, D = matrices
        return replace(self, A=A, B=B, C=C, D=D, **changes)

    def renamed(self, ports: Mapping[str, str] | None = None, elements: Mapping[str, str] | None = None) -> System:
        """The same system with other names of ports and elements (a name that is not given stays).

        Raises
        ------
        ValueError
            A name to be replaced that does not exist.
        """
        ports, elements = _mapping(ports, "ports"), _mapping(elements, "elements")
        known = {p.name for p in self.inputs + self.outputs}
        for name in ports:
            if name not in known:
                raise InputError(f"port must be one of {', '.join(sorted(known))}, got {name!r}")
        for name in elements:
            self.element(name)
        return replace(
            self,
            inputs=tuple(replace(p, name=ports.get(p.name, p.name)) for p in self.inputs),
            outputs=tuple(replace(p, name=ports.get(p.name, p.name)) for p in self.outputs),
            channels=tuple(elements.get(c, c) for c in self.channels),
            elements=tuple(replace(e, name=elements.get(e.name, e.name)) for e in self.elements),
        )

    def sorted_channels(self, order: Sequence[str] | None = None) -> System:
        """The same LFT with the channels of each element adjacent, in the order of `order` (default: as stored)."""
        names = [e.name for e in self.elements] if order is None else list(order) if isinstance(order, Iterable) else []
        if not set(self.channels) <= {name for name in names if isinstance(name, str)}:
            raise InputError(f"order must name {', '.join(sorted(set(self.channels)))}, got {order!r}"[:300])
        q = len(self.channels)
        rank = {name: i for i, name in enumerate(names)}
        permutation = np.array(sorted(range(q), key=lambda i: rank[self.channels[i]]), dtype=int)
        columns = np.r_[permutation, np.arange(q, self.D.shape[1])].astype(int)
        rows = np.r_[permutation, np.arange(q, self.D.shape[0])].astype(int)
        return replace(
            self,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            channels=tuple(self.channels[i] for i in permutation),
            elements=tuple(self.element(name) for name in names if name in self.channels),
        )

    def normalised(self) -> System:
        """The same uncertain system with every element of size at most 1 and nominal value 0.

        A symmetric real range is scaled; an asymmetric one uses the bilinear map of :attr:`RealParameter.bilinear`,
        which adds no occurrence: a normalised value nu is the physical value ``parameter.from_normalised(nu)``.
        Complex and dynamic elements are divided by radius or bound.
        """
        q = len(self.channels)
        normalised = {e.name: _normalised(e) for e in self.elements}
        ab = np.array([normalised[c][:2] for c in self.channels]).reshape(q, 2)
        B, D = self.B.copy(), self.D.copy()
        B[:, :q] *= ab[:, 0]
        D[:, :q] *= ab[:, 0]
        D[np.arange(q), np.arange(q)] -= ab[:, 1]
        return replace(self, B=B, D=D, elements=tuple(e for *_, e in normalised.values()))

    # conversion

    @classmethod
    def static(cls, gain: ArrayLike, inputs: Sequence[Any], outputs: Sequence[Any], name: str = "gain") -> System:
        """System without states, ``y = gain u``."""
        none = np.zeros((0, 0))
        return cls(none, none, none, gain, inputs, outputs, name)  # type: ignore[arg-type]

    @classmethod
    def from_control(
        cls,
        system: Any,
        units: Mapping[str, str] | None = None,
        name: str = "",
        *,
        inputs: Sequence[Port] | None = None,
        outputs: Sequence[Port] | None = None,
    ) -> System:
        """System of a `control.StateSpace` or `control.TransferFunction`, with its period.

        Parameters
        ----------
        system : control.StateSpace or control.TransferFunction
            Signals ``w[0], w[1], ...`` become one port ``w``, wherever they stand.
        units : mapping, optional
            SI unit of each port by name.
        name : str, optional
            Taken from the system otherwise.
        inputs, outputs : sequence of Port, optional
            Ports whose signals are the labels in some order, or which name them anew.

        Raises
        ------
        ValueError
            Another type, a discrete system without a period in seconds (dt True), or labels from which the ports do
            not follow: one used twice, a missing index, ``w`` beside ``w[0]``.
        """
        matrices, ports_in, ports_out = ports_and_matrices(system, units, inputs, outputs)
        if system.dt is True:
            raise InputError("system must have a sampling period in seconds, got dt True")
        return cls(*matrices, ports_in, ports_out, name or str(system.name), float(system.dt or 0.0))

    @checked
    def to_control(self, name: str | None = None) -> control.StateSpace:
        """`control.StateSpace` with the signal names of the ports, from which :meth:`from_control` makes them again.

        Raises
        ------
        ValueError
            An uncertain system, or a port whose name is that of a signal of another port, for instance ``w[0]``.
        """
        dt = self.dt or (0.0 if self.order else None)  # a gain may stand in either time
        return control_system(self.matrices, self.inputs, self.outputs, dt, self.name if name is None else name)


def _mapping(value: Any, what: str) -> dict[str, Any]:
    """A mapping as a dict, None as an empty one; a ValueError that begins with `what` for anything else."""
    if value is not None and not isinstance(value, Mapping):
        raise InputError(f"{what} must be a mapping from names to values, got {value!r}")
    return dict(value or {})


def _normalised(element: Element) -> tuple[float, float, Element]:
    """Coefficients of the map from the element of size 1 (:attr:`RealParameter.bilinear`), and that element."""
    if isinstance(element, RealParameter):
        return *element.bilinear, RealParameter(element.name, 0.0, -1.0, 1.0, "1", element.description)
    if isinstance(element, ComplexParameter):
        return element.radius, 0.0, ComplexParameter(element.name, 0.0, 1.0, "1", element.description)
    return element.bound, 0.0, replace(element, bound=1.0)


@checked
def state_space(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, inputs: Sequence[Port], outputs: Sequence[Port]
) -> System:
    """System without elements from its matrices, in continuous time."""
    return System(A, B, C, D, tuple(inputs), tuple(outputs))  # type: ignore[arg-type]


@checked
def static_gain(matrix: ArrayLike, inputs: Sequence[Port], outputs: Sequence[Port]) -> System:
    """Gain without states or elements: ``y = matrix u``."""
    return System.static(matrix, tuple(inputs), tuple(outputs), "system")


@checked
def from_control(system: Any, inputs: Sequence[Port] | None = None, outputs: Sequence[Port] | None = None) -> System:
    """A system of python-control as a :class:`System`: see :meth:`System.from_control`.

    Examples
    --------
    >>> import control
    >>> w = control.ss([[-1]], [[1, 2, 3]], [[1]], [[0, 0, 0]], inputs=["w[0]", "v", "w[1]"], outputs=["z"])
    >>> from_control(w)["z", "w"].B.tolist()
    [[1.0, 3.0]]
    """
    return System.from_control(system, inputs=inputs, outputs=outputs)
