import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import norm

from bench.analysis.noise import likelihood
from bench.analysis.noise.allan import allan_deviation
from bench.analysis.noise.components import Stretch
from bench.analysis.noise.estimate import Noise, estimate_noise, profile_noise
from bench.analysis.noise.floor import noise_floor
from bench.analysis.noise.likelihood import NoiseLattice, Record, Surface, beside, gls
from bench.analysis.noise.lines import without_lines
from bench.analysis.noise.whitening import Ratios, Whitener, covariance
from bench.base.errors import InputError
from bench.record.dataset import Dataset

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import allantools
    import statsmodels.api as sm


def gyro_noise(rng, rows, interval_s, noise=(0.01, 0.03, 0.03)):
    """White + flicker (spectral synthesis) + walk: a generator that shares nothing with the covariance."""
    n, b, k = noise
    length = 1 << int(np.ceil(np.log2(8 * rows)))
    frequency = np.fft.rfftfreq(length, interval_s)
    density = np.zeros_like(frequency)
    density[1:] = b**2 / (2.0 * np.pi * frequency[1:])
    lines = (rng.normal(size=len(density)) + 1j * rng.normal(size=len(density))) * np.sqrt(
        density * length / interval_s / 2.0
    )
    hours = interval_s / 3600.0
    walk = np.cumsum(rng.normal(size=rows)) * k * np.sqrt(hours)
    return rng.normal(size=rows) * n / np.sqrt(hours) + np.fft.irfft(lines, length)[:rows] + walk


@pytest.fixture
def rng():
    return np.random.default_rng(7)


class TestLines:
    def still(self, rate):
        time = np.arange(len(rate)) + 0.5
        channels = {"rate": rate, "temperature": np.full(len(rate), 25.0)}
        return Dataset("still", time, channels, np.zeros(len(rate), dtype=np.int64), (), 1.0)

    def test_a_vibration_is_named_with_its_period_and_size_and_is_no_noise(self, rng):
        rate = gyro_noise(rng, 9000, 1.0)
        wave = 4.0 * np.sin(2.0 * np.pi * np.arange(9000) / 31.3 + 0.4)
        shaken = np.where(rng.random(9000) < 0.05, np.nan, rate + wave)
        alone, shaken = (noise_floor([self.still(each)], 30.0) for each in (rate, shaken))
        assert alone.lines == ()
        (line,) = shaken.lines
        assert line.period_s == pytest.approx(31.3, abs=0.01)
        assert line.amplitude_dph == pytest.approx(4.0, rel=0.02)
        assert shaken.floor_dph == pytest.approx(alone.floor_dph, rel=0.05)
        assert "deg/h with a period of 31.30 s is not counted as noise" in shaken.notes[0]

    def test_spikes_are_no_noise_and_are_told(self, rng):
        rate = gyro_noise(rng, 9000, 1.0)
        struck = rate.copy()
        struck[[700, 3100, 3111, 8200]] += [300.0, -200.0, 400.0, 250.0]
        alone, spiky = (noise_floor([self.still(each)], 30.0) for each in (rate, struck))
        assert alone.notes == ()
        assert spiky.floor_dph == pytest.approx(alone.floor_dph, rel=0.03)
        assert spiky.notes == ("3 means with spikes are not counted as noise",)

    @pytest.mark.parametrize("colour", ["white", "walk", "flicker", "heavy", "telegraph", "filtered"])
    def test_noise_of_any_colour_has_no_line(self, rng, colour):
        found = 0
        for _ in range(40):
            noise = rng.normal(size=6000)
            rate = {
                "white": lambda x: x,
                "walk": np.cumsum,
                "flicker": lambda _: gyro_noise(rng, 6000, 1.0, (0.01, 1.0, 0.0)),
                "heavy": lambda _: rng.standard_t(2.5, 6000),
                "filtered": lambda x: lfilter([1.0], [1.0, -0.97], x),
                "telegraph": lambda x: 0.3 * x + np.cumsum(rng.random(6000) < 0.003) % 2,
            }[colour](noise)
            found += bool(without_lines(rate, 1.0)[1])
        assert found <= 1


class TestAllanDeviation:
    def test_agrees_with_allantools(self, rng):
        rate = gyro_noise(rng, 5000, 1.0) + 3.0
        curve = allan_deviation(rate, 1.0)
        tau, deviation, _, counts = allantools.oadev(rate, rate=1.0, data_type="freq", taus=curve.tau_s)
        assert_allclose(curve.tau_s, tau)
        assert_allclose(curve.deviation_dph, deviation, rtol=1e-12)
        assert_allclose(curve.counts, counts)

    def test_counts_only_terms_without_a_gap(self, rng):
        rate = rng.normal(size=300)
        holed = rate.copy()
        holed[[40, 41, 170]] = np.nan
        m = 7
        means = [np.mean(holed[i : i + m]) for i in range(300 - m + 1)]
        steps = np.array([means[i + m] - means[i] for i in range(300 - 2 * m + 1)])
        steps = steps[np.isfinite(steps)]
        curve = allan_deviation(holed, 2.0, np.array([2.0 * m]))
        assert_allclose(curve.deviation_dph, np.sqrt(np.mean(steps**2) / 2.0), rtol=1e-12)
        assert curve.counts.tolist() == [len(steps)]

    def test_band_holds_the_truth_as_often_as_it_says(self):
        inside = total = 0
        for seed in range(60):
            rate = gyro_noise(np.random.default_rng(seed), 1000, 1.0, (0.6, 0.0, 0.0))
            curve = allan_deviation(rate, 1.0, np.array([1.0, 10.0, 100.0]))
            truth = 0.6 / np.sqrt(curve.tau_s / 3600.0)
            inside += int(np.sum((curve.low_dph < truth) & (truth < curve.high_dph)))
            total += 3
        assert 0.90 <= inside / total <= 0.99

    def test_refuses_what_has_no_deviation(self):
        for rate in (np.array([]), np.array([1.0, np.nan, 2.0]), np.full(100, 5.0)):
            with pytest.raises(InputError):
                allan_deviation(rate, 1.0)


class TestGls:
    def test_agrees_with_statsmodels(self, rng):
        time_s = np.arange(200) * 30.0
        X = np.vander(np.linspace(-1, 1, 200), 4) * np.array([1e6, 1.0, 1e-6, 1.0])
        y = X @ [1e-6, 2.0, 3e6, 4.0] + gyro_noise(rng, 200, 30.0)
        ratios = Ratios(0.3, 0.2)
        ours = gls(X, y, Whitener.of(ratios, time_s, 30.0))
        theirs = sm.GLS(y, X, sigma=covariance(time_s, 30.0, ratios)).fit()
        assert_allclose(ours.beta, theirs.params, rtol=1e-9)
        deviation = np.sqrt(np.diag(theirs.cov_params()))
        scale = np.outer(deviation, deviation)
        assert_allclose(ours.covariance / scale, theirs.cov_params() / scale, atol=1e-9)

    def test_a_repeated_column_gets_half_each_and_no_infinite_variance(self, rng):
        time_s = np.arange(100) * 30.0
        y = 4.0 + 0.1 * rng.normal(size=100)
        fit = gls(np.ones((100, 2)), y, Whitener.of(Ratios(), time_s, 30.0))
        assert_allclose(fit.beta, [y.mean() / 2] * 2)
        assert np.isfinite(fit.covariance).all()

    @pytest.mark.parametrize("noise", [(0.01, 0.0, 0.0), (0.01, 0.05, 0.0), (0.01, 0.03, 0.1)])
    def test_bands_hold_the_truth(self, noise):
        """95 % bands of a quadratic in time-varying temperature, noise profiled in the same record."""
        rows, inside = 200, 0
        time_s = np.arange(rows) * 30.0
        temperature = np.sin(2 * np.pi * time_s / 9000.0)
        X = np.vander(temperature, 3)
        for seed in range(30):
            y = X @ [1.0, -2.0, 0.5] + gyro_noise(np.random.default_rng(seed), rows, 30.0, noise)
            fit = profile_noise(X, y, time_s).fit
            z = (fit.beta - [1.0, -2.0, 0.5])[:2] / np.sqrt(np.diag(fit.covariance))[:2]
            inside += int(np.sum(np.abs(z) < norm.ppf(0.975)))
        assert inside / 60 >= 0.86


class TestNoise:
    def test_estimate_finds_all_three_in_a_long_record(self, rng):
        noise = estimate_noise([Stretch(gyro_noise(rng, 1200, 60.0, (0.01, 0.05, 0.4)))], 60.0).with_intervals()
        assert_allclose(noise.white, 0.01, rtol=0.25)
        assert_allclose(noise.walk, 0.4, rtol=0.25)
        for name, truth in zip(("white", "flicker", "walk"), (0.01, 0.05, 0.4), strict=True):
            low, high = noise.intervals[name]
            assert low <= truth <= high

    def test_short_soaks_with_thermal_tails_give_the_white_noise_and_say_what_they_cannot(self, rng):
        tail = 0.3 * np.exp(-np.arange(1500) / 400.0)
        noise = estimate_noise([Stretch(gyro_noise(rng, 1500, 1.0) + tail) for _ in range(5)], 1.0).with_intervals()
        assert_allclose(noise.white, 0.01, rtol=0.06)
        assert noise.undetermined in (("flicker", "walk"), ("walk",))
        assert noise.intervals["walk"][1] > 0.03

    def test_gaps_do_not_matter(self, rng):
        rate = gyro_noise(rng, 600, 30.0, (0.01, 0.0, 0.0))
        rate[rng.random(600) < 0.2] = np.nan
        assert_allclose(estimate_noise([Stretch(rate)], 30.0).noise.white, 0.01, rtol=0.1)

    def test_too_short_is_refused(self):
        with pytest.raises(InputError, match="isothermal"):
            estimate_noise([Stretch(np.zeros(4)), Stretch(np.full(100, np.nan))], 30.0)

    def test_a_constant_output_has_no_noise_to_read(self):
        with pytest.raises(InputError, match="constant"):
            estimate_noise([Stretch(np.full(600, 5.0))], 1.0)

    def test_samples_that_scatter_less_than_the_rows_say_are_not_believed(self, rng):
        """A unit with a narrow band: its samples are not white, and N is what the rows show."""
        rate = gyro_noise(rng, 7200, 1.0, (0.01, 0.0, 0.0))
        half = np.full(7200, 0.5 * (0.01 * 60.0) ** 2 * 500)
        found = estimate_noise([Stretch(rate, np.full(7200, 500.0), half)], 1.0)
        assert not found.white_samples
        low, high = found.with_intervals().intervals["white"]
        assert low <= 0.01 <= high

    def test_quantisation_is_found_where_the_rows_cannot_be_explained_without(self, rng):
        error = rng.uniform(-0.5e-4, 0.5e-4, 7201)
        rate = gyro_noise(rng, 7200, 1.0, (0.001, 0.0, 0.0)) + 3600.0 * np.diff(error)
        noise = estimate_noise([Stretch(rate)], 1.0).with_intervals()
        low, high = noise.intervals["quantisation"]
        assert low <= 1e-4 / np.sqrt(12.0) <= high
        assert_allclose(noise.quantisation, 1e-4 / np.sqrt(12.0), rtol=0.05)

    def test_floor_is_the_rms_that_a_constant_leaves(self):
        runs = [gyro_noise(np.random.default_rng(seed), 1050, 30.0) for seed in range(200)]
        expected = np.sqrt(np.mean([np.var(run) for run in runs]))
        assert_allclose(Noise(0.01, 0.03, 0.03).std_of_means(30.0, 1050 * 30.0), expected, rtol=0.02)

    def test_floor_is_that_of_the_covariance(self):
        noise = Noise(0.01, 0.03, 0.1)
        time_s = (np.arange(1200) + 0.5) * 10.0
        dense = covariance(time_s, 10.0, noise.ratios(10.0)) * noise.white_variance(10.0)
        expected = np.sqrt(np.trace(dense) / 1200 - dense.sum() / 1200**2)
        assert_allclose(noise.std_of_means(10.0, 12000.0), expected, rtol=1e-9)

    def test_an_isothermal_record_sharpens_the_profile(self, rng):
        """The ratios found with three more hours of isothermal data are the maximum of the joint likelihood."""
        time_s = np.arange(300) * 30.0
        X = np.vander(np.sin(time_s / 1500.0), 4)
        still = Record(np.arange(360) * 30.0, gyro_noise(rng, 360, 30.0), np.ones((360, 1)))
        fit = profile_noise(X, gyro_noise(rng, 300, 30.0), time_s, [still])
        assert_allclose(np.sqrt(fit.sigma2 * 30.0 / 3600.0), 0.01, rtol=0.15)


class TestLattice:
    def test_records_at_the_same_times_share_their_whiteners(self, rng):
        time_s = np.arange(200) * 30.0
        first, second = (
            NoiseLattice([Record(time_s, gyro_noise(rng, 200, 30.0), np.ones((200, 1)))], 30.0) for _ in range(2)
        )
        assert first.at([(-16, -16)])[0][0] is second.at([(-16, -16)])[0][0]
        other = NoiseLattice([Record(time_s, np.zeros(200), np.ones((200, 1)), np.full(200, 2.0))], 30.0)
        assert other.at([(-16, -16)])[0][0] is not first.at([(-16, -16)])[0][0]

    def test_forgetting_whiteners_changes_nothing(self, rng, monkeypatch):
        record = Record(np.arange(150) * 30.0, gyro_noise(rng, 150, 30.0), np.ones((150, 1)))

        def lowest():
            likelihood._axis.cache_clear()
            surface = Surface.of([record], NoiseLattice([record], 30.0), restricted=True)
            best = surface.search()
            return best, surface.height(best)

        usual = lowest()
        monkeypatch.setattr(likelihood, "_MOST_KEPT", 30)
        assert lowest() == usual


class TestCorrelatedNoise:
    """White noise behind a filter, made by `scipy.signal.lfilter` sample by sample, 0.2 s each."""

    N, FILTER_S = 0.0083, 20.0

    def rows(self, rng, seconds, interval_s=1.0):
        fine = rng.normal(size=round(5 * seconds)) * self.N * np.sqrt(3600.0 / 0.2)
        keep = np.exp(-0.2 / self.FILTER_S)
        settled = lfilter([1.0 - keep], [1.0, -keep], np.concatenate([fine[:2000], fine]))[2000:]
        return settled.reshape(-1, round(5 * interval_s)).mean(axis=1)

    def test_it_is_told_from_flicker_and_walk_and_the_floor_is_that_of_long_runs(self, rng):
        floors = [np.std(self.rows(rng, 20_010, 30.0)) for _ in range(10)]
        found = [estimate_noise([Stretch(self.rows(rng, 1500)) for _ in range(5)], 1.0) for _ in range(20)]
        assert_allclose([one.noise.correlation_s for one in found], self.FILTER_S, rtol=0.5)
        assert_allclose([one.noise.white for one in found], self.N, rtol=0.35)
        assert_allclose([one.noise.std_of_means(30.0, 20_000.0) for one in found], np.mean(floors), rtol=0.3)
        inside = [low < np.mean(floors) < high for low, high in (one.floor_interval(30.0, 20_000.0) for one in found)]
        assert sum(inside) >= 16

    def test_its_allan_deviation_is_that_of_the_simulation(self, rng):
        filtered = self.rows(rng, 200_000)
        noise = Noise(
            self.N, 0.0, 0.0, correlated=self.N / np.sqrt(2 * self.FILTER_S / 3600), correlation_s=self.FILTER_S
        )
        tau, deviation, *_ = allantools.oadev(filtered, rate=1.0, data_type="freq", taus=[4, 20, 60, 300, 1000])
        assert_allclose(noise.allan_deviation(np.array(tau)), deviation, rtol=0.08)

    def test_it_is_not_seen_in_white_noise_flicker_and_walk(self, rng):
        found = [estimate_noise([Stretch(gyro_noise(rng, 3000, 1.0))], 1.0).noise for _ in range(20)]
        assert [noise.correlated for noise in found] == [0.0] * 20


@pytest.mark.parametrize(("swing_degc", "told"), [(0.75, True), (4.0, False)])
def test_a_chamber_that_cycles_about_one_temperature_still_tells_the_floor(rng, swing_degc, told):
    time = np.arange(0.5, 14_400.0)
    temperature = 25.0 + swing_degc * np.sin(2.0 * np.pi * time / 640.0)
    rate = 0.3 * temperature + rng.normal(size=time.size) * 0.0083 * 60.0
    run = Dataset(
        "cycling", time, {"temperature": temperature, "rate": rate}, np.zeros(time.size, dtype=np.int64), (), 1.0
    )
    floor = noise_floor([run], 30.0, intervals=False)
    assert bool(floor.reason) is not told
    if told:
        assert floor.floor_dph == pytest.approx(0.0083 / np.sqrt(30.0 / 3600.0), rel=0.05)


def test_no_columns_leave_the_whole_response(capfd: pytest.CaptureFixture[str]) -> None:
    """Without a column there is nothing to project, and no library complains about a matrix of no rows."""
    response = np.arange(4.0)
    rest, volume = beside(np.empty((4, 0)), response)
    assert rest.tolist() == response.tolist()
    assert volume == 0.0
    assert capfd.readouterr() == ("", "")
