"""Pointing budgets: the standard's example, closed forms, integrals over frequency, samples, mistakes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize, special
from support.command_line import refused

import pointing_analysis
from lftkit.errors import InputError
from pointing_analysis.budget import sources as kinds
from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.lines import combine, contribution, periodic, uniform
from pointing_analysis.budget.total import axis_factor, axis_total, evaluate, norm_quantile
from pointing_analysis.indices import metrics
from pointing_analysis.indices.metrics import windows
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.indices.weights import rpe_exact

FOLDER = Path(pointing_analysis.__file__).parent / "budget"
HEAD = 'unit = "mas"\ndraws = 20000\n'


def budget(tmp_path: Path, text: str, requirement: str = "prob(|APE_x| < 10 mas) >= 0.9 at 95 % confidence"):
    """Verdict of a budget with one requirement."""
    file = tmp_path / "budget.toml"
    file.write_text(f'{HEAD}[[requirement]]\ntext = "{requirement}"\n{text}')
    return evaluate(load_budget(file))[0]


def test_the_example_of_the_standard_to_its_digits() -> None:
    """Annex C of ECSS-E-ST-60-10C; one printed digit contradicts the others, see tests/published."""
    found = load_budget(FOLDER / "budget_ecss_annex_c.toml")
    ape, rpe = (axis_total(found, rule) for rule in found.totals)
    assert np.round(ape.rss, 2).tolist() == [13.51, 8.37, 8.61]
    assert np.round(ape.level, 2).tolist()[:2] == [27.01, 16.75]
    assert ape.level[2] == pytest.approx(17.21, abs=0.0065)
    assert np.round(rpe.rss, 2).tolist() == [10.70, 6.89, 6.28]
    assert np.round(rpe.level, 2).tolist() == [21.40, 13.78, 12.57]


def test_factors_of_gaussian_errors() -> None:
    assert axis_factor(0.997) == pytest.approx(2.96774, abs=5e-6)
    for probability, factor in ((0.95, 2.44775), (0.997, 3.40856), (0.9973, 3.43933)):
        assert norm_quantile(np.zeros(2), np.ones(2), probability) == pytest.approx(factor, abs=6e-6)
    assert norm_quantile(np.zeros(2), np.array([2.0, 0.0]), 0.997) == pytest.approx(2 * 2.96774, abs=2e-5)
    assert norm_quantile(np.array([3.0, 4.0]), np.zeros(2), 0.9) == 5.0


def test_a_tone_has_the_quantile_of_a_sine(tmp_path: Path) -> None:
    found = budget(tmp_path, '[sources.a]\ntype = "periodic"\nfrequency = 30\namplitude = [4, 0]\n')
    assert found.level == pytest.approx(4 * math.sin(0.9 * math.pi / 2), rel=5e-3)
    assert found.rss == pytest.approx(axis_factor(0.9) * 4 / math.sqrt(2))


@pytest.mark.parametrize("hertz", [3.0, 11.0, 42.0])
def test_a_tone_within_an_exposure(hertz: float) -> None:
    source = kinds.tones(("a",), [2 * math.pi * hertz], np.array([[1.0], [1j]]))
    rng = np.random.default_rng(2)
    drawn = source.draw(rng, rng.random(200_000), 0.02)
    expected = rpe_exact(2 * math.pi * hertz, 0.02) / math.sqrt(2)
    assert source.sigma(0.02) == pytest.approx([expected, expected])
    assert drawn.std(axis=0) == pytest.approx([expected, expected], rel=0.01)
    assert np.all(np.abs(drawn).max(axis=0) <= source.worst(0.02) * 1.01)


def test_interpretations_and_transfers(tmp_path: Path) -> None:
    text = (
        '[sources.group]\ntransfer = 0.5\n[sources.group.bias]\ntype = "constant"\nhalf_range = 2\n'
        '[sources.group.tone]\ntype = "periodic"\nfrequency = 10\namplitude = [6, 0]\n'
        "transfer = {numerator = [62.83185307], denominator = [1, 62.83185307]}\n"
    )
    amplitude = 0.5 * 6 / math.sqrt(2)  # at the corner of the low-pass
    kept = "prob(|APE_x| < 10 mas) >= 0.9 at 95 % confidence"
    levels = {
        kind: budget(tmp_path, text, kept + tail).level
        for kind, tail in (("temporal", ""), ("ensemble", ", ensemble"), ("mixed", ", mixed"))
    }
    # of |1 + a sin| with the bias at its limit for all of the time: nine tenths are below where sin is 0.4 pi
    assert levels["temporal"] == pytest.approx(1.0 + amplitude * math.sin(0.4 * math.pi), rel=5e-3)
    assert levels["ensemble"] == pytest.approx(amplitude + 0.9, rel=5e-3)
    assert levels["mixed"] < min(levels["temporal"], levels["ensemble"])


def test_a_constant_error_has_one_sign_for_all_of_the_time(tmp_path: Path) -> None:
    """Quantile of |10 + N(0, 3) + 6 sin| by quadrature over the phase: 22.353."""
    text = (
        '[sources.bias]\ntype = "constant"\nhalf_range = [10, 0]\n[sources.noise]\ntype = "random"\n'
        'sigma = [3, 0]\n[sources.sine]\ntype = "periodic"\nfrequency = 0.001\namplitude = [6, 0]\n'
    )
    phase = np.pi * (np.arange(2000) + 0.5) / 1000.0

    def inside(q: float) -> float:
        mean = 10.0 + 6.0 * np.sin(phase)
        return float(np.mean(special.ndtr((q - mean) / 3.0) - special.ndtr((-q - mean) / 3.0)))

    expected = optimize.brentq(lambda q: inside(q) - 0.997, 10.0, 30.0)
    found = budget(tmp_path, text, "prob(|APE_x| < 30 mas) >= 0.997 at 95 % confidence")
    assert expected == pytest.approx(22.353, abs=1e-3)
    assert abs(found.level - expected) <= 2.0 * found.uncertainty < 1.0


@pytest.mark.parametrize("transfer", ["-1.0", "{numerator = [-62.8], denominator = [1, 62.8]}"])
@pytest.mark.parametrize(
    ("known", "mean"), [("constant", "value = [10, 4]"), ("drift", "rate = [0.5, 0.2]\nduration = 40")]
)
def test_known_errors_behind_gains_of_opposite_sign_cancel(
    tmp_path: Path, known: str, mean: str, transfer: str
) -> None:
    """The sign of a gain had been lost: 20 in place of 0 for a bias and its calibration."""
    entry = f'type = "{known}"\n{mean}\n'
    found = budget(tmp_path, f"[sources.a]\n{entry}[sources.b]\ntransfer = {transfer}\n[sources.b.c]\n{entry}")
    means = np.array([share.mean for share in found.shares])
    assert np.abs(means) == pytest.approx(np.array([[10, 4], [10, 4]])) and means.sum(axis=0) == pytest.approx([0, 0])
    if known == "constant":
        assert found.level == found.rss == pytest.approx(0.0, abs=1e-12)


def test_sigmas_behind_a_negative_gain_are_positive(tmp_path: Path) -> None:
    rows = ['"random"\nsigma = 2', '"constant"\nhalf_range = 2', '"periodic"\nfrequency = 3\namplitude = 2']
    rows.append('"spectrum"\nfrequency = [1, 2]\npsd = [2, 2]')
    for row in rows:
        one, other = (budget(tmp_path, f"[sources.a]\ntransfer = {gain}\ntype = {row}\n") for gain in (3, -3))
        assert one.shares[0].sigma.tolist() == other.shares[0].sigma.tolist() and min(one.shares[0].sigma) > 0
        assert one.rss == other.rss and not np.signbit(other.shares[0].mean).any()


def test_an_rms_of_windows_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It had been judged at every instant under the title rms: 50 in place of 50 / sqrt(2) for a tone of 100 Hz."""
    tone = '[sources.a]\ntype = "periodic"\nfrequency = 100\namplitude = [50, 0]\n'
    with pytest.raises(ValueError, match=r"must be on \|RPE_x\(20 ms\)\| in a budget, .* got 'rms RPE_x\(20 ms\)'$"):
        budget(tmp_path, tone, "prob(rms RPE_x(20 ms) < 40 mas) >= 0.997 at 95 % confidence")
    page = tmp_path / "page.html"
    line = refused(capsys, "budget", tmp_path / "budget.toml", "--output", page, "--json")
    assert "rms RPE_x(20 ms)" in line and not page.exists()


def test_a_spectrum_and_a_drift(tmp_path: Path) -> None:
    flat = budget(tmp_path, '[sources.a]\ntype = "spectrum"\nfrequency = [10, 110]\npsd = [0.04, 0.04]\n')
    assert flat.shares[0].sigma == pytest.approx([2.0, 2.0], rel=1e-3)
    drift = budget(tmp_path, '[sources.a]\ntype = "drift"\nrate = [0.1, 0]\nduration = 20\n')
    assert drift.level == pytest.approx(0.9 * 2, rel=1e-2)  # uniform from 0 to 2


def test_a_measured_bag_replaces_a_source(tmp_path: Path) -> None:
    noise = 3 * np.random.default_rng(5).standard_normal((20_000, 2))
    write_bag(tmp_path / "bag", {"truth/los": noise * math.pi / 648_000_000})
    requirement = "prob(|RPE(20 ms)| < 10 mas) >= 0.9 at 95 % confidence"
    found = budget(tmp_path, '[sources.a]\ntype = "measured"\nbag = "bag"\ntransient = 1.0\n', requirement)
    assert found.level == pytest.approx(3 * math.sqrt(19 / 20) * math.sqrt(2 * math.log(10)), rel=0.02)


def test_a_recorded_source_that_the_sensor_did_not_see_is_refused(tmp_path: Path) -> None:
    """A budget of a stuck or clipped sensor would be too small; fewer such samples than may exceed are missing ones."""
    sources = '[sources.a]\ntype = "measured"\nbag = "bench.csv"\ntransient = 0.0\n'
    for stuck, clip, said in ((6000, math.inf, "stuck: 30 %"), (0, 1.0, "saturated: "), (100, math.inf, "")):
        e = np.random.default_rng(1).standard_normal((20_000, 2)).clip(-clip, clip)
        e[: stuck + 1] = e[0]
        table = np.column_stack([1e-3 * np.arange(len(e)), e])
        np.savetxt(tmp_path / "bench.csv", table, delimiter=",", header="time,x (mas),y (mas)", comments="")
        if said:
            with pytest.raises(InputError, match=f"a: bag must show the motion: {said}"):
                budget(tmp_path, sources)
        else:
            assert budget(tmp_path, sources).level == pytest.approx(1.645, rel=0.05)
    table[:, 1:] = 4.0 * np.round(table[:, 1:] / 4.0)
    np.savetxt(tmp_path / "bench.csv", table, delimiter=",", header="time,x (mas),y (mas)", comments="")
    with pytest.raises(InputError, match="a: bag must show the motion: the values have steps of 4 mas"):
        budget(tmp_path, sources)


def test_a_measured_source_takes_the_windows_of_an_analysis(tmp_path: Path) -> None:
    """10.24 samples of 1/512 s; a steady drift is uniform over the window, as a source of type drift is."""
    error = np.column_stack([np.arange(5120.0), np.random.default_rng(1).standard_normal(5120)])
    source, window = kinds.measured(("a",), error, 1 / 512), 0.02
    assert source.sigma(window) == pytest.approx(metrics.rpe_rms(error, 1 / 512, window), rel=1e-12)
    u = (np.arange(20_000) + 0.5) / 20_000
    drawn = source.draw(np.random.default_rng(2), u, window)
    assert drawn.std(axis=0) == pytest.approx(source.sigma(window), rel=0.01)
    assert np.abs(drawn[:, 0] - 10.24 * (u - 0.5)).max() <= 0.51  # half a sample
    assert np.all(np.abs(drawn).max(axis=0) <= source.worst(window) + 1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "sources must hold at least one source"),
        ('[sources.a]\ntype = "magic"\n', "a: type must be one of constant, .* got 'magic'"),
        ('[sources.a]\ntype = "random"\nsigma = -1\n', "a: sigma must be zero or more"),
        ('[sources.a]\ntype = "random"\nsigma = [1, 2, 3]\n', "sigma must be 2 finite numbers"),
        (
            '[sources.a]\ntype = "random"\nsigma = 1\nvalue = 2\n',
            "unknown parameter 'sources.a.value', expected one of: correlation_time, sigma, transfer, type",
        ),
        ('[sources.a.b]\ntype = "random"\nsgma = 1\n', r"unknown parameter 'sources.a.b.sgma': did you mean sigma\?"),
        ('[source.a]\ntype = "random"\n', r"unknown parameter 'source': did you mean sources\?"),
        ('[sources.a]\ntype = "tones"\n', "tones must be a list"),
        ('[sources.a]\ntype = "measured"\nbag = "none"\n', "no such file or folder"),
        ('[sources.a]\ntype = "testbed"\n', "type testbed needs the command"),
        ('[sources.a]\ntype = "random"\nsigma = 1\ntransfer = "x"\n', "transfer must be a number"),
        (
            '[sources.a]\ntype = "constant"\nvalue = 1\ntransfer = {numerator = [1], denominator = [1, 0]}\n',
            "a: transfer must be finite at the frequencies",
        ),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        budget(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("share", "draws", "message"),
    [
        ("99.999999999999 %", 50_000, r'share must be at most 0\.9999996 of a distribution \(summation = "rss"'),
        ("0.99999", 1000, "draws must be 400000 or more"),
        ("0.9999", 20_000, "draws must be 40000 or more"),
        ("0.9999", 40_000, ""),
    ],
)
def test_a_share_needs_draws_beyond_it(tmp_path: Path, share: str, draws: int, message: str) -> None:
    """Of a Gaussian of 1.8 mas a share of fourteen nines is at 13.9 mas: 50 000 draws show 7.6 mas."""
    file = tmp_path / "budget.toml"
    text = f"prob(|APE| < 10 mas) >= {share} at 95 % confidence"
    source = '[sources.a]\ntype = "random"\nsigma = [1.8, 0]\n'
    file.write_text(f'unit = "mas"\ndraws = {draws}\n[[requirement]]\ntext = "{text}"\n{source}')
    if message:
        with pytest.raises(ValueError, match=message) as refused:
            load_budget(file)
        assert text in str(refused.value), "as its author wrote it"
        file.write_text(f'summation = "rss"\n{file.read_text()}')
    (found,) = evaluate(load_budget(file))
    part = float(share.removesuffix(" %")) / (100.0 if "%" in share else 1.0)
    assert found.total == pytest.approx(1.8 * axis_factor(part), rel=1e-3 if message else 0.05)


def test_an_unstable_transfer_is_refused(tmp_path: Path) -> None:
    transfer = "transfer = {numerator = [1], denominator = [1, -1]}"
    with pytest.raises(ValueError, match="transfer must be stable, got 'a pole of real part 1 rad/s'"):
        budget(tmp_path, f'[sources.a]\ntype = "drift"\nrate = [1, 1]\nduration = 1\n{transfer}')


OF_WINDOWS = 'unit = "mas"\n[[requirement]]\ntext = "prob(|RPE(1 s)| < 20 mas) >= 0.997 at 95 % confidence"\n'


def source(tmp_path: Path, text: str) -> kinds.ErrorSource:
    """The one source of a budget."""
    (tmp_path / "budget.toml").write_text(f"{OF_WINDOWS}[sources.a]\n{text}\n")
    return load_budget(tmp_path / "budget.toml").sources[0]


def flat(low: float, high: float, density: float, window: float) -> float:
    """Sigma within a window of a constant density: integral of S (1 - sinc(f T)^2)."""
    f = np.linspace(low, high, 400_001)
    return math.sqrt(np.trapezoid(density * (1 - np.sinc(f * window) ** 2), f))


@pytest.mark.parametrize(
    ("low", "high", "density", "window"),
    [(39.8, 40.2, 250.0, 1.0), (39.3, 39.7, 250.0, 1.0), (1.0, 500.0, 0.1, 10.0), (1.0, 500.0, 0.1, 0.02)],
)
def test_a_spectrum_above_the_parts_of_a_window(
    tmp_path: Path, low: float, high: float, density: float, window: float
) -> None:
    """The covariance had been sampled at 40 positions: 2.06 in place of 10 for a cooler at 40 Hz in 1 s."""
    found = source(tmp_path, f'type = "spectrum"\nfrequency = [{low}, {high}]\npsd = [{density}, {density}]')
    expected = flat(low, high, density, window)
    assert found.sigma(window) == pytest.approx([expected] * 2, rel=1e-5)
    rng = np.random.default_rng(4)
    assert found.draw(rng, rng.random(200_000), window).std(axis=0) == pytest.approx([expected] * 2, rel=0.01)


def test_a_narrow_spectrum_is_the_tone_of_its_power(tmp_path: Path) -> None:
    """And the total breaks the limit that the tone breaks."""
    narrow = source(tmp_path, 'type = "spectrum"\nfrequency = [39.8, 40.2]\npsd = [250, 250]')
    tone = kinds.tones(("a",), [80 * math.pi], [[math.sqrt(200)], [math.sqrt(200)]])
    assert narrow.sigma(1.0) == pytest.approx(tone.sigma(1.0), rel=1e-4)
    (verdict,) = evaluate(load_budget(tmp_path / "budget.toml"))
    assert verdict.total == pytest.approx(34.09, rel=0.02) and not verdict.compliant


def test_a_spectrum_at_a_position(tmp_path: Path) -> None:
    """At the end of a window more is left than at its middle; slow spectra keep their digits."""
    found = source(tmp_path, 'type = "spectrum"\nfrequency = [1e-9, 2e-9]\npsd = [1e18, 1e18]')
    rng = np.random.default_rng(5)
    ends, middle = (found.draw(rng, np.full(100_000, u), 1.0).std() for u in (0.0, 0.5))
    rate = 2 * math.pi * math.sqrt(1e18 * (8e-27 - 1e-27) / 3)
    assert found.sigma(1.0) == pytest.approx([rate / math.sqrt(12)] * 2, rel=1e-5)
    assert ends == pytest.approx(rate * (0.5 - 0.5 / kinds.POSITIONS), rel=0.01) and middle < 0.03 * ends


def test_a_peak_between_the_steps_of_a_wide_spectrum(tmp_path: Path) -> None:
    """A line of 0.02 Hz and power 10 at 40 Hz beside nine decades of little."""
    text = "[1e-6, 39.985, 39.99, 40.01, 40.015, 1000]\npsd = [1e-9, 1e-9, 500, 500, 1e-9, 1e-9]"
    found = source(tmp_path, f'type = "spectrum"\nfrequency = {text}')
    flanks = 2 * 0.005 * 500 / math.log(5e11)
    assert found.sigma(None) ** 2 == pytest.approx([10 + flanks] * 2, rel=1e-3)


@pytest.mark.parametrize("ratio", [1e-7, 1e-3, 0.099, 0.101, 1.0, 30.0, 1e3, 1e7])
def test_the_closed_form_of_exponential_correlation(ratio: float) -> None:
    """Also where the window is far shorter or longer than the correlation."""
    found = kinds.correlated(("a",), [3.0, 0.0], 1 / ratio)
    if ratio > 0.01:
        expected = 1 - 2 / ratio * (1 - (1 - math.exp(-ratio)) / ratio)
    else:
        expected = ratio / 3 - ratio**2 / 12 + ratio**3 / 60
    assert found.sigma(1.0) ** 2 == pytest.approx([9 * expected, 0.0], rel=1e-9)


def test_exponential_correlation_at_each_position() -> None:
    """Against the covariance at 2000 instants of the window."""
    window, tau, parts = 0.02, 0.03, kinds.POSITIONS
    t = (np.arange(50 * parts) + 0.5) / (50 * parts) * window
    table = np.exp(-np.abs(t[:, None] - t) / tau)
    expected = (1 - 2 * table.mean(axis=0) + table.mean()).reshape(parts, 50).mean(axis=1)
    found, rng = kinds.correlated(("a",), [1.0], tau), np.random.default_rng(6)
    for k in (0, 3, parts // 2, parts - 1):
        drawn = found.draw(rng, np.full(100_000, (k + 0.5) / parts), window)
        assert drawn.std() == pytest.approx(math.sqrt(expected[k]), rel=0.01)


@pytest.mark.parametrize("window", [0.012, 0.0125])
def test_a_tone_of_a_sampled_loop_is_that_of_its_record(window: float) -> None:
    """Also in windows that are no whole number of samples: of 12.5 ms, 12 samples had been taken."""
    omega, dt = 2 * np.pi * 41.0, 1e-3
    los = np.sin(omega * dt * np.arange(50_000))
    expected = windows(np.column_stack([los, los]), dt, window).variance.mean()
    found = kinds.tones(("tone",), [omega], np.ones((1, 1)), dt)
    assert found.sigma(window)[0] ** 2 == pytest.approx(expected, rel=2e-3)
    rng = np.random.default_rng(1)
    assert np.square(found.draw(rng, rng.random(40_000), window)).mean() == pytest.approx(expected, rel=0.02)


def test_means_add_linearly_and_do_not_enter_the_rpe() -> None:
    parts = [contribution("a", 3.0, mean=[1, -2, 0]), contribution("b", 4.0, mean=[1, -2, 0])]
    ape, rpe = combine(parts, "APE", 3.0), combine(parts, "RPE", 3.0)
    assert ape.rss.tolist() == [5, 5, 5]
    assert ape.mean.tolist() == [2, -4, 0]
    assert ape.level.tolist() == [17, 19, 15]
    assert rpe.level.tolist() == [15, 15, 15]


def test_standard_deviations_against_samples() -> None:
    rng = np.random.default_rng(0)
    assert uniform(2.0) == pytest.approx(rng.uniform(-2, 2, 400_000).std(), rel=5e-3)
    assert periodic(2.0) == pytest.approx((2 * np.sin(rng.uniform(0, 2 * np.pi, 400_000))).std(), rel=5e-3)


def test_level_holds_the_stated_share_of_a_mixed_sum() -> None:
    """Two sigmas of a sum of uniform, periodic and Gaussian errors hold about 95 % (central limit)."""
    rng = np.random.default_rng(1)
    n = 200_000
    total = rng.uniform(-3, 3, n) + 2 * np.sin(rng.uniform(0, 2 * np.pi, n)) + rng.standard_normal(n)
    parts = [contribution("u", uniform(3.0)), contribution("p", periodic(2.0)), contribution("g", 1.0)]
    assert np.mean(np.abs(total) < combine(parts, "APE", 2.0).level[0]) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: contribution("a", -1.0), "zero or more"),
        (lambda: contribution("a", [np.nan, 1, 1]), "zero or more"),
        (lambda: combine([contribution("a", 1.0)], "XYZ"), "index must be APE or RPE"),
        (lambda: combine([]), "number of axes, got none"),
        (lambda: combine([contribution("a", 1.0), contribution("b", [1.0, 2.0])]), "number of axes"),
    ],
)
def test_bad_input(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
