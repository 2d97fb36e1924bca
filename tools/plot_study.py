#!/usr/bin/env python3
"""Pictures of a study: probability of capture, with what is known of it.

    tools/plot_study.py STUDY.h5 [-o PICTURE.png]

One varied key: probability against it, with its band (95 %, Wilson). Two in a grid: a map,
cells whose interval holds 0.5 hatched, as too uncertain to call. Other studies: a ranking of
the keys by the permutation importance of a random forest (needs scikit-learn) and the
cases as parallel coordinates. A search: the points it chose and the answer it found, for
each combination of the other keys. Beside them the convergence of the estimate with the
number of runs.
"""
import argparse
from pathlib import Path

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

BLUE, GREY, RED = "#1f5a8a", "#8a8a8a", "#b8432f"
COLOURS = [BLUE, RED, "#2e8b57", "#c58a1a", "#6a4c93", "#555555"]


def wilson(k, n, z=1.959963984540054):
    """Wilson's interval, as castnet computes it; 0 to 1 without a run."""
    k, n = np.asarray(k, float), np.asarray(n, float)
    with np.errstate(invalid="ignore", divide="ignore"):
        p = k / n
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return np.where(n > 0, middle - half, 0.0), np.where(n > 0, middle + half, 1.0)


def text(value) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


class Study:
    """A study's table: `keys` as (column, name in the scene), /case, /point and /search as dictionaries of arrays."""

    def __init__(self, path):
        with h5py.File(path) as f:
            self.case, self.point, self.search = (
                {k: v[()] for k, v in f[g].items()} if g in f else {} for g in ("case", "point", "search"))
            if "status" not in self.case:
                raise SystemExit(f"{path} has no finished case")
            self.keys = [(k, text(v.attrs["key"])) for k, v in f["case"].items() if "key" in v.attrs]
            others = [k for k, v in f["search"].items() if "key" in v.attrs] if self.search else []
            self.searched = next((key for key in self.keys if self.search and key[0] not in others), None)
            self.text = text(f["meta/study"][()]) if "meta/study" in f else ""
            answer = f["meta/answer"][()] if "meta/answer" in f else ""
        self.answer = text(answer)
        self.done = self.case["status"] == 0

    def varied(self):
        """Keys that take more than one value."""
        return [key for key in self.keys if np.unique(self.case[key[0]]).size > 1]

    def of_points(self):
        """Keys that differ between points, rather than from run to run."""
        return [key for key in self.keys if self.point and np.unique(self.point[key[0]]).size > 1]

    def is_grid(self, keys) -> bool:
        count = [np.unique(self.point[k]).size for k, _ in keys]
        return np.prod(count) == self.point["point"].size


def band(ax, x, probability, lower, upper, label, colour=BLUE):
    order = np.argsort(x)
    ax.fill_between(x[order], lower[order], upper[order], color=colour, alpha=0.18, lw=0)
    ax.plot(x[order], probability[order], "o-", color=colour, ms=4, lw=1.3, label=label)
    ax.set(ylabel="probability of capture", ylim=(-0.03, 1.03))


def chart(ax, x, y, probability, lower, upper):
    """Probability over two keys as colour; hatched where the interval holds 0.5. Returns the colours for a bar."""
    xs, ys = np.unique(x), np.unique(y)
    grid = {n: np.full((ys.size, xs.size), np.nan) for n in ("p", "lower", "upper")}
    ix, iy = np.searchsorted(xs, x), np.searchsorted(ys, y)
    for n, values in (("p", probability), ("lower", lower), ("upper", upper)):
        grid[n][iy, ix] = values
    ex, ey = edges(xs), edges(ys)
    mesh = ax.pcolormesh(ex, ey, grid["p"], cmap="RdYlBu", vmin=0, vmax=1)
    for j, i in np.argwhere((grid["lower"] < 0.5) & (grid["upper"] > 0.5)):
        ax.add_patch(plt.Rectangle((ex[i], ey[j]), ex[i + 1] - ex[i], ey[j + 1] - ey[j], fill=False, hatch="////", lw=0,
                                   ec="#333333"))
    return mesh


def edges(values):
    """Borders half-way between neighbours."""
    if values.size == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def draw_curve(ax, study, key):
    p = study.point
    band(ax, p[key[0]], p["probability"], p["lower"], p["upper"], "estimate and 95 % interval")
    ax.set(xlabel=key[1])
    ax.legend(frameon=False, fontsize=8)


def draw_map(fig, ax, study, keys):
    p = study.point
    mesh = chart(ax, p[keys[0][0]], p[keys[1][0]], p["probability"], p["lower"], p["upper"])
    fig.colorbar(mesh, ax=ax, label="probability of capture")
    ax.set(xlabel=keys[0][1], ylabel=keys[1][1])
    ax.set_title("hatched: too uncertain to call", fontsize=9)


def draw_search(ax, study):
    """The points of each search, and where its answer lies."""
    key, p, s = study.searched, study.point, study.search
    others = [k for k in study.keys if k != key and np.isfinite(s[k[0]]).all()]
    for i in range(s["search"].size):
        here = np.ones(p["point"].size, bool)
        for k, _ in others:
            here &= p[k] == s[k][i]
        colour = COLOURS[i % len(COLOURS)]
        label = ", ".join(f"{name.split('/')[-1]} = {s[k][i]:g}" for k, name in others) or "estimate and its interval"
        x, n = p[key[0]][here], p["runs"][here]
        order = np.argsort(x)
        ax.errorbar(x[order], p["probability"][here][order],
                    yerr=np.abs(np.vstack([p["lower"][here], p["upper"][here]]) - p["probability"][here])[:, order],
                    fmt="none", ecolor=colour, alpha=0.35, lw=1)
        ax.scatter(x, p["probability"][here], s=6 + 60 * n / max(1, p["runs"].max()), color=colour, label=label, zorder=3)
        if s["found"][i]:
            ax.axvline(s["estimate"][i], color=colour, lw=1.2)
            if np.isfinite(s["lower"][i]):
                ax.axvspan(s["lower"][i], s["upper"][i], color=colour, alpha=0.12, lw=0)
    ax.set(xlabel=key[1], ylabel="probability of capture", ylim=(-0.03, 1.03))
    ax.set_title("larger marks: more runs; lines: the answers", fontsize=9)
    ax.legend(frameon=False, fontsize=7)


def draw_ranking(ax, study, keys):
    x = np.column_stack([study.case[k][study.done] for k, _ in keys])
    y = study.case["captured"][study.done]
    problem = ""
    try:
        from sklearn.ensemble import RandomForestClassifier
        from sklearn.inspection import permutation_importance
    except ImportError:
        problem = "the ranking needs scikit-learn:\npip install scikit-learn"
    if not problem and np.unique(y).size < 2:
        problem = "all runs ended alike:\nnothing to rank"
    if problem:
        ax.text(0.5, 0.5, problem, ha="center", va="center")
        ax.axis("off")
        return
    # What the forest says of runs that it has not seen: fitted on one half, shuffled on the other.
    half = np.random.default_rng(0).permutation(y.size) < y.size // 2
    forest = RandomForestClassifier(300, random_state=0, min_samples_leaf=3).fit(x[half], y[half])
    found = permutation_importance(forest, x[~half], y[~half], n_repeats=20, random_state=0)
    order = np.argsort(found.importances_mean)
    ax.barh(np.arange(len(order)), found.importances_mean[order], xerr=found.importances_std[order], color=BLUE)
    ax.axvline(0, color="k", lw=0.6)
    ax.set_yticks(np.arange(len(order)), [keys[i][1] for i in order], fontsize=8)
    ax.set(xlabel="accuracy lost when the key is shuffled")
    guess = max(y.mean(), 1 - y.mean())
    ax.set_title(f"random forest: {forest.score(x[~half], y[~half]):.2f} of unseen runs right (a guess {guess:.2f})", fontsize=9)


def draw_parallel(ax, study, keys, most=400):
    """Every case a line over its keys, from each one's smallest to its largest value."""
    pick = np.flatnonzero(study.done)
    pick = np.random.default_rng(0).permutation(pick)[:most]
    low = np.array([study.case[k].min() for k, _ in keys])
    high = np.array([study.case[k].max() for k, _ in keys])
    for hit, colour in ((0, RED), (1, BLUE)):
        rows = pick[study.case["captured"][pick] == hit]
        values = np.column_stack([study.case[k][rows] for k, _ in keys])
        ax.plot(np.arange(len(keys)), ((values - low) / (high - low)).T, color=colour, lw=0.6, alpha=0.25)
        ax.plot([], [], color=colour, label="captured" if hit else "not captured")
    for i, (_, name) in enumerate(keys):
        ax.axvline(i, color="k", lw=0.8)
        ax.annotate(f"{low[i]:.3g}", (i, -0.03), ha="center", va="top", fontsize=7)
        ax.annotate(f"{high[i]:.3g}", (i, 1.03), ha="center", va="bottom", fontsize=7)
    ax.set_xticks(range(len(keys)), [name.replace("/", "/\n") for _, name in keys], fontsize=7)
    ax.tick_params(axis="x", pad=12, length=0)
    ax.set(yticks=[], ylim=(-0.12, 1.22))
    for side in ax.spines.values():
        side.set_visible(False)
    ax.legend(frameon=False, fontsize=7, ncol=2, loc="upper center")


def draw_convergence(ax, study, most=4, least=5):
    """The estimate as its runs come in: at the most uncertain points, or of the whole study where points have few runs."""
    case, done = study.case, study.done
    order = np.argsort(case["case"][done])
    point, hit = case["point"][done][order], case["captured"][done][order]
    runs = {q: (point == q).sum() for q in np.unique(point)}
    if runs and max(runs.values()) >= least:
        share = {q: hit[point == q].mean() for q, n in runs.items() if n >= least}
        chosen = [(q, hit[point == q]) for q in sorted(share, key=lambda q: abs(share[q] - 0.5))[:most]]
        ax.set_title("convergence at the most uncertain points", fontsize=9)
    else:
        # The first run of every point, then the second: not the order of the points.
        within = np.array([(point[:i] == q).sum() for i, q in enumerate(point)]) if max(runs.values(), default=1) > 1 else 0
        chosen = [(None, hit[np.lexsort((np.arange(hit.size), within + 0 * point))])]
        ax.set_title("convergence over the whole study", fontsize=9)
    for (q, h), colour in zip(chosen, COLOURS):
        n = np.arange(1, h.size + 1)
        lower, upper = wilson(np.cumsum(h), n)
        ax.plot(n, np.cumsum(h) / n, lw=1.3, color=colour, label=place(study, q))
        ax.fill_between(n, lower, upper, color=colour, alpha=0.12, lw=0)
    ax.set(xlabel="runs", ylabel="probability of capture", ylim=(-0.03, 1.03))
    if chosen and chosen[0][0] is not None:
        ax.legend(frameon=False, fontsize=7)


def place(study, q):
    """A point by the values of its keys."""
    if q is None or not study.point:
        return ""
    row = np.flatnonzero(study.point["point"] == q)
    if row.size == 0:
        return f"point {q}"
    return ", ".join(f"{name.split('/')[-1]} = {study.point[k][row[0]]:.4g}" for k, name in study.of_points())


def draw(study):
    """The figure that suits the study."""
    keys = study.of_points()
    if study.search:
        fig, axes = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
        draw_search(axes[0], study)
    elif len(keys) == 1 and study.point["runs"].max() > 1:
        fig, axes = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
        draw_curve(axes[0], study, keys[0])
    elif len(keys) == 2 and study.is_grid(keys):
        fig, axes = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
        draw_map(fig, axes[0], study, keys)
    elif study.varied():
        fig, axes = plt.subplots(1, 3, figsize=(15, 4.6), constrained_layout=True)
        draw_ranking(axes[0], study, study.varied())
        draw_parallel(axes[1], study, study.varied())
    else:
        fig, axes = plt.subplots(1, 1, figsize=(6, 4.2), constrained_layout=True, squeeze=False)
        axes = axes[0]
    draw_convergence(axes[-1], study)
    bad = int((~study.done).sum())
    title = f"{study.case['case'].size} captures" + (f", {bad} of them not run to the end" if bad else "")
    fig.suptitle(title if study.answer.count("\n") > 1 else study.answer or title, fontsize=9, wrap=True)
    return fig


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("-o", "--output")
    a = parser.parse_args()
    study = Study(a.study)
    out = a.output or str(Path(a.study).with_suffix(".png"))
    draw(study).savefig(out, dpi=130)
    print(out)


if __name__ == "__main__":
    main()
