#!/usr/bin/env python3
"""Pictures of a study: probability of capture, with what is known of it.

    tools/plot_study.py STUDY.h5 [-o PICTURE.png]

One varied key: probability against it, with its 95 % band. Two: a map, cells whose
interval holds both capture and loss (0.5) hatched. More: a ranking of the keys by the
permutation importance of a random forest (needs scikit-learn), and the outcome along
each key. Beside them the convergence of the estimate with the number of runs.
"""
import argparse

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

BLUE, GREY, RED = "#1f5a8a", "#8a8a8a", "#b8432f"


def wilson(k, n, z=1.959963984540054):
    """Wilson's interval, as castnet computes it."""
    k, n = np.asarray(k, float), np.asarray(n, float)
    with np.errstate(invalid="ignore", divide="ignore"):
        p = k / n
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return middle - half, middle + half


def read(path):
    """Varied keys (column, label), /case and /point as dictionaries of arrays."""
    with h5py.File(path) as f:
        cases = {k: v[()] for k, v in f["case"].items()}
        points = {k: v[()] for k, v in f["point"].items()} if "point" in f and len(f["point"]) else {}
        keys = [(k, v.attrs["key"]) for k, v in f["case"].items() if "key" in v.attrs]
        answer = f["meta/answer"][()] if "answer" in f["meta"] else b""
    keys = [(k, v.decode() if isinstance(v, bytes) else v) for k, v in keys]
    return keys, cases, points, answer.decode() if isinstance(answer, bytes) else answer


def curve(ax, key, label, points):
    order = np.argsort(points[key])
    x = points[key][order]
    ax.fill_between(x, points["lower"][order], points["upper"][order], color=BLUE, alpha=0.2, lw=0, label="95 % interval")
    ax.plot(x, points["probability"][order], "o-", color=BLUE, ms=4, label="captured")
    ax.set(xlabel=label, ylabel="probability of capture", ylim=(-0.03, 1.03))
    ax.legend(frameon=False, fontsize=8)


def chart(fig, ax, keys, points):
    (kx, lx), (ky, ly) = keys
    xs, ys = np.unique(points[kx]), np.unique(points[ky])
    grid = {n: np.full((ys.size, xs.size), np.nan) for n in ("probability", "lower", "upper")}
    ix, iy = np.searchsorted(xs, points[kx]), np.searchsorted(ys, points[ky])
    for n in grid:
        grid[n][iy, ix] = points[n]
    edges = [np.concatenate([[v[0] - (v[1] - v[0]) / 2], (v[1:] + v[:-1]) / 2, [v[-1] + (v[-1] - v[-2]) / 2]]) for v in (xs, ys)]
    mesh = ax.pcolormesh(edges[0], edges[1], grid["probability"], cmap="RdYlBu", vmin=0, vmax=1)
    for j in range(ys.size):
        for i in range(xs.size):
            if grid["lower"][j, i] < 0.5 < grid["upper"][j, i]:
                ax.add_patch(plt.Rectangle((edges[0][i], edges[1][j]), np.diff(edges[0])[i], np.diff(edges[1])[j],
                                           fill=False, hatch="////", lw=0, ec="#333333"))
    fig.colorbar(mesh, ax=ax, label="probability of capture")
    ax.set(xlabel=lx, ylabel=ly, title="hatched: too uncertain to call")


def ranking(ax, keys, cases):
    done = cases["status"] == 0
    x = np.column_stack([cases[k][done] for k, _ in keys])
    y = cases["captured"][done]
    try:
        from sklearn.ensemble import RandomForestClassifier
        from sklearn.inspection import permutation_importance
    except ImportError:
        ax.text(0.5, 0.5, "the ranking needs scikit-learn:\npip install scikit-learn", ha="center", va="center")
        ax.axis("off")
        return
    forest = RandomForestClassifier(300, oob_score=True, random_state=0, min_samples_leaf=3).fit(x, y)
    found = permutation_importance(forest, x, y, n_repeats=20, random_state=0)
    order = np.argsort(found.importances_mean)
    ax.barh(np.arange(len(order)), found.importances_mean[order], xerr=found.importances_std[order], color=BLUE)
    ax.set_yticks(np.arange(len(order)), [keys[i][1] for i in order], fontsize=8)
    ax.set(xlabel="loss of accuracy when the key is shuffled", title=f"out-of-bag accuracy {forest.oob_score_:.2f}")


def marginals(ax, keys, cases):
    done = cases["status"] == 0
    y = cases["captured"][done]
    for n, (k, label) in enumerate(keys[:6]):
        x = cases[k][done]
        bins = np.quantile(x, np.linspace(0, 1, 9))
        at = np.clip(np.searchsorted(bins, x, side="right") - 1, 0, 7)
        share = [y[at == b].mean() if (at == b).any() else np.nan for b in range(8)]
        ax.plot(np.linspace(0, 1, 8), share, "o-", ms=3, label=label)
    ax.set(xlabel="from the smallest to the largest value", ylabel="share captured", ylim=(-0.03, 1.03))
    ax.legend(frameon=False, fontsize=7)


def convergence(ax, cases):
    """Estimate at the most uncertain points as their runs come in."""
    done = cases["status"] == 0
    point, hit = cases["point"][done], cases["captured"][done]
    p = {q: hit[point == q].mean() for q in np.unique(point)}
    for q in sorted(p, key=lambda q: abs(p[q] - 0.5))[:4]:
        h = hit[point == q]
        n = np.arange(1, h.size + 1)
        lower, upper = wilson(np.cumsum(h), n)
        line, = ax.plot(n, np.cumsum(h) / n, lw=1.2, label=f"point {q}")
        ax.fill_between(n, lower, upper, color=line.get_color(), alpha=0.12, lw=0)
    ax.set(xlabel="runs", ylabel="probability of capture", ylim=(-0.03, 1.03), title="convergence, most uncertain points")
    ax.legend(frameon=False, fontsize=7)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("-o", "--output")
    a = parser.parse_args()
    keys, cases, points, answer = read(a.study)
    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
    varied = [k for k in keys if points and np.unique(points[k[0]]).size > 1]
    regular = points and points["runs"].max() > 1 or len(varied) < 3
    if len(varied) == 1:
        curve(left, *varied[0], points)
    elif len(varied) == 2 and regular and np.unique(points[varied[0][0]]).size * np.unique(points[varied[1][0]]).size == points["runs"].size:
        chart(fig, left, varied, points)
    else:
        ranking(left, varied or keys, cases)
        marginals(right, varied or keys, cases)
    if not right.has_data():
        convergence(right, cases)
    bad = int((cases["status"] != 0).sum())
    title = f"{cases['case'].size} captures" + (f", {bad} of them not run to the end" if bad else "")
    fig.suptitle(answer or title, fontsize=10)
    out = a.output or a.study.rsplit(".", 1)[0] + ".png"
    fig.savefig(out, dpi=130)
    print(out)


if __name__ == "__main__":
    main()
