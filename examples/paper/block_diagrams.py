r"""Block diagrams of the two generalised plants of the paper: that of K_FSM and that of K_PMA.

Signals have the paper's names: a tilde is a normalised signal, the index m a measured one, :math:`\tilde n` is white
noise of unit density. What is inside the dashed frame is the generalised plant.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle
from matplotlib.path import Path

Point = tuple[float, float]

WIDTH = 186.0
"""Of a diagram, in its own units; text of 9 points is 2.7 of them high."""

PLANT, WEIGHT, CONTROLLER, UNCERTAIN, SENSOR = "#dbe7f2", "#fdf3d5", "#f3d9ea", "#e6e6e6", "#e2f0e2"
"""Colours of the kinds of blocks."""

RADIUS = 1.9
"""Of a sum."""


@dataclass
class Diagram:
    """Blocks, sums and wires, drawn in the order of their kinds.

    Parameters
    ----------
    height : float
        In the units of :data:`WIDTH`.
    frame : (float, float, float, float)
        Left, bottom, right and top of the generalised plant.
    name : str
        Of the generalised plant, at the upper left corner of the frame.
    """

    height: float
    frame: tuple[float, float, float, float]
    name: str
    blocks: list[tuple[Point, Point, str, str]] = field(default_factory=list)
    sums: list[Point] = field(default_factory=list)
    wires: list[tuple[tuple[Point, ...], bool]] = field(default_factory=list)
    dots: list[Point] = field(default_factory=list)
    texts: list[tuple[Point, str, str]] = field(default_factory=list)

    def block(self, centre: Point, size: Point, text: str, colour: str) -> None:
        """A box of a size around its centre."""
        self.blocks.append((centre, size, text, colour))

    def wire(self, *points: Point, arrow: bool = True) -> None:
        """A line through points, with an arrow at its end."""
        self.wires.append((points, arrow))

    def text(self, at: Point, text: str, align: str = "center") -> None:
        """A name of a signal, above its point."""
        self.texts.append((at, text, align))


def draw_diagram(figure: Figure, diagram: Diagram) -> Axes:
    """Draw a diagram over the whole of a figure."""
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(0.0, diagram.height), aspect="equal")
    axes.set_axis_off()
    left, bottom, right, top = diagram.frame
    axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, fill=False, ls="--", lw=0.9, ec="#555555"))
    axes.text(left + 2.0, top - 2.0, diagram.name, ha="left", va="top", fontsize=11)
    for points, arrow in diagram.wires:
        style = {"arrowstyle": "-|>", "mutation_scale": 9.0} if arrow else {"arrowstyle": "-"}
        line = FancyArrowPatch(path=Path(points), color="black", lw=0.9, joinstyle="miter", **style)
        axes.add_patch(line)
    for (x, y), (width, height), text, colour in diagram.blocks:
        corner = (x - width / 2.0, y - height / 2.0)
        axes.add_patch(Rectangle(corner, width, height, fc=colour, ec="black", lw=0.9, zorder=3))
        axes.text(x, y, text, ha="center", va="center", zorder=4)
    for x, y in diagram.sums:
        axes.add_patch(Circle((x, y), RADIUS, fc="white", ec="black", lw=0.9, zorder=3))
        axes.text(x, y, "+", ha="center", va="center_baseline", fontsize=8, zorder=4)
    for x, y in diagram.dots:
        axes.add_patch(Circle((x, y), 0.7, color="black", zorder=3))
    for (x, y), text, align in diagram.texts:
        axes.text(x, y, text, ha=align, va="bottom", zorder=4)
    return axes


def fsm_synthesis() -> Diagram:
    """Generalised plant P of K_FSM, the observer that drives the mirror."""
    found = Diagram(
        120.0, (16.0, 23.0, 168.0, 117.0), r"$\mathcal{P}(s, \Delta_\Omega, \Delta_\tau, \Delta_{A_\bullet})$"
    )
    top, left = 14.0, 94.0
    columns = _telescope(found, 0.0, "$W_{RPE}$", "$e_{RPE}$", top)
    found.block(
        ((left + 158.0) / 2.0, 9.0), (158.0 - left, 2.0 * (top - 9.0)), r"$K_{FSM}(s)$, $2 \times 22$", CONTROLLER
    )
    for x, name in columns.items():
        found.text((x + 1.5, 17.0), name, "left")
    _mirror_law(found, (38.0, 36.0), 50.0, (left, 9.0))
    found.dots.append((38.0, 50.0))
    found.block((27.0, 50.0), (13.0, 8.0), "$W_{u_{fsm}}$", WEIGHT)
    found.wire((38.0, 50.0), (33.5, 50.0))
    found.wire((20.5, 50.0), (4.0, 50.0))
    found.text((8.0, 51.0), "$e_u^{fsm}$")
    return found


def pma_synthesis() -> Diagram:
    """Generalised plant Q of K_PMA, with the mirror's loop closed."""
    up = 22.0
    found = Diagram(
        142.0, (16.0, 22.0, 168.0, 139.0), r"$\mathcal{Q}(s, \Delta_\Omega, \Delta_\tau, \Delta_{A_\bullet})$"
    )
    top, left, middle = 36.0, 98.0, 31.0
    columns = _telescope(found, up, "$W_{RPE}^f$", "$e_{RPE}^f$", top)
    found.block(
        ((left + 158.0) / 2.0, middle), (158.0 - left, 2.0 * (top - middle)), r"$K_{FSM}(s)$, $2 \times 22$", CONTROLLER
    )
    for x, name in columns.items():
        found.text((x + 1.5, 38.0), name, "left")
    _mirror_law(found, (44.0, 36.0 + up), 48.0 + up, (left, middle))
    platform, branch, row, low = min(columns), 91.0, 58.0 + up, 11.0
    found.dots.append((platform, 42.0))
    found.wire((platform, 42.0), (branch, 42.0), (branch, low), (84.0, low))
    found.text((branch + 1.5, 13.0), columns[platform], "left")
    found.block((74.0, low), (20.0, 12.0), "$K_{PMA}(s)$\n" + r"$6 \times 6$", CONTROLLER)
    found.wire((64.0, low), (32.0, low), (32.0, row), (58.0, row))
    found.text((49.0, low + 1.0), "$u_{pma}$")
    found.text((52.0, row + 1.0), "$u_{pma}$")
    found.dots.append((32.0, row))
    found.block((24.5, row), (12.0, 8.0), "$W_{u_{pma}}$", WEIGHT)
    found.wire((32.0, row), (30.5, row), arrow=False)
    found.wire((18.5, row), (4.0, row))
    found.text((8.0, row + 1.0), "$e_u^{pma}$")
    return found


def _telescope(found: Diagram, up: float, weight: str, error: str, end: float) -> dict[float, str]:
    """What both problems share; the columns of the measured signals, whose wires end at a height."""
    found.block((76.0, 68.0 + up), (36.0, 48.0), "telescope\n$\\mathcal{M}^{ST}(s)$\n\n204 states", PLANT)
    uncertain = r"$\Delta_\Omega, \Delta_\tau, \Delta_{A_\bullet}$"
    found.block((76.0, 104.0 + up), (30.0, 8.0), uncertain, UNCERTAIN)
    found.wire((68.0, 92.0 + up), (68.0, 100.0 + up))
    found.wire((84.0, 100.0 + up), (84.0, 92.0 + up))
    for y, kind in ((84.0 + up, "rws"), (72.0 + up, "sa")):
        found.wire((4.0, y), (30.0, y))
        found.block((38.0, y), (16.0, 8.0), f"$W_{{{kind}}}$", WEIGHT)
        found.wire((46.0, y), (58.0, y))
        found.text((9.0, y + 1.0), rf"$\tilde w_{{{kind}}}$")
        found.text((52.0, y + 1.0), f"$w_{{{kind}}}$")
    _errors(found, up, weight, error)
    return _sensors(found, up, end)


def _errors(found: Diagram, up: float, relative_weight: str, relative_error: str) -> None:
    """Weights of the line of sight."""
    los, branch, end = 86.0 + up, 106.0, 182.0
    found.text((100.0, los + 1.0), "$LOS_c$")
    found.dots.append((branch, los))
    rows = ((107.0 + up, los, "$W_{APE}$", "$e_{APE}$"), (95.0 + up, 95.0 + up, relative_weight, relative_error))
    for y, start, weight, error in rows:
        found.wire((branch, start), (branch, y), (120.0, y))
        found.block((128.0, y), (16.0, 8.0), weight, WEIGHT)
        found.wire((136.0, y), (end, y))
        found.text((176.0, y + 1.0), error)
    found.dots.append((branch, 95.0 + up))


def _sensors(found: Diagram, up: float, end: float) -> dict[float, str]:
    """Measured signals with their filters and noise, each a column."""
    rows = (
        (102.0, 50.0, r"$\ddot x_{I_p}$", r"\sigma_a", r"\tilde n_{a_p}", "$F_w$", r"$\ddot x_{I_p}^m$"),
        (118.0, 62.0, r"$\theta_{fsm}$", r"\sigma_{FSM}", r"\tilde n_{FSM}", "", r"$\theta_{fsm}^m$"),
        (
            134.0,
            74.0,
            r"$\ddot x_{M_1}, \ddot x_{M_2}$",
            r"\sigma_a",
            r"\tilde n_{a_m}",
            "$F_w$",
            r"$\ddot x_{M_1}^m, \ddot x_{M_2}^m$",
        ),
        (150.0, 86.0, "", r"\sigma_{LOS}", r"\tilde n_{LOS}", "", "$LOS_c^m$"),
    )
    for x, row, name, sigma, noise, washout, _ in rows:
        middle = 42.0 + up
        found.wire((94.0, row + up), (x, row + up), (x, middle + RADIUS))
        found.text((95.0, row + up + 1.0), name, "left")
        found.sums.append((x, middle))
        found.block((x + 8.6, middle), (9.0, 7.0), f"${sigma}$", SENSOR)
        found.wire((x + 4.1, middle), (x + RADIUS, middle))
        found.wire((x + 8.6, middle + 9.0), (x + 8.6, middle + 3.5))
        found.text((x + 8.6, middle + 9.0), f"${noise}$")
        if washout:
            found.wire((x, middle - RADIUS), (x, middle - 6.0))
            found.block((x, middle - 9.5), (9.0, 7.0), washout, SENSOR)
            found.wire((x, middle - 13.0), (x, end))
        else:
            found.wire((x, middle - RADIUS), (x, end))
    found.block((150.0, 70.0 + up), (11.0, 8.0), "$F_{LOS}$", SENSOR)
    return {x: measured for x, *_, measured in rows}


def _mirror_law(found: Diagram, centre: Point, row: float, start: Point) -> None:
    """From the estimate at its start to the mirror's command in a row of the telescope."""
    x, y = centre
    found.wire(start, (x, start[1]), (x, y - 4.0))
    found.text((66.0, start[1] + 1.0), r"$\widehat{LOS}$")
    found.block(centre, (18.0, 8.0), "$-S_{FSM}^{-1}$", CONTROLLER)
    found.wire((x, y + 4.0), (x, row), (58.0, row))
    found.text((52.0, row + 1.0), "$u_{fsm}$")


def names(diagram: Diagram) -> Iterable[str]:
    """Every text of a diagram."""
    return [diagram.name, *(text for *_, text, _ in diagram.blocks), *(text for _, text, _ in diagram.texts)]
