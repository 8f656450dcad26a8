"""Texts of the reports of ``carina bench render`` and ``isoregion``: rows of a section as lines of text."""

from __future__ import annotations

from typing import Any

__all__ = ["beside", "first_frame", "frames", "memory", "paper", "prepared", "small_frames", "views"]

Rows = list[dict[str, Any]]


def frames(rows: Rows) -> list[str]:
    """Return the lines of the report on frames of 512 x 512.

    Ratios come first, because machines can be compared by ratios.
    """
    lines = [
        "  512x512, step 0.5 voxel, shaded, one thread; all stop at VTK's 1/128 (leap/VTK also at Carina's 1/512)",
        "  CPU time, median over rounds (least); VTK without its window",
        f"  {'case':14} {'view':8} {'leap/VTK':>15} {'AVX2 leap/VTK':>15} {'brute/VTK':>15} {'leap/brute':>15} "
        f"{'at 1/512':>10} {'shipped/VTK':>15} {'VTK ms':>7} {'brute':>6} {'leap':>6} {'shipped':>7} "
        f"{'decorated':>9}  off baseline",
    ]
    for row in rows:
        ratio, cpu = row["ratio"], row["cpu_ms"]

        def both(key: str, ratio: dict[str, Any] = ratio) -> str:
            return f"{ratio[key]['median']:.2f} ({ratio[key]['min']:.2f})" if key in ratio else "-"

        best = [key for key in cpu if key.startswith("brute-")][-1].removeprefix("brute-")
        off = row["brute_minus_baseline"]
        lines.append(
            f"  {row['case'][:14]:14} {row['view']:8} {both('leap_over_vtk'):>15} {both('avx2_leap_over_vtk'):>15} "
            f"{both('brute_over_vtk'):>15} {both('leap_over_brute'):>15} "
            f"{ratio['leap_with_own_stop_over_vtk']['median']:10.2f} {both('shipped_over_vtk'):>15} "
            f"{cpu['vtk']['median']:7.1f} {cpu[f'brute-{best}']['median']:6.1f} {cpu[f'leap-{best}']['median']:6.1f} "
            f"{cpu[f'shipped-leap-{best}']['median']:7.1f} {cpu[f'decorated-leap-{best}']['median']:9.1f}  "
            f"max {off['max']}, {100 * off['share_of_pixels']:.3f} % of pixels"
        )
    return lines


def small_frames(rows: Rows) -> list[str]:
    """Return the lines of the section of frames of 256 x 256."""
    return [
        f"  {row['case'][:14]:14} {row['look']:10} 256x256, two threads: {row['frames_per_s']:.0f} frames/s; "
        f"{row['frames_per_s_on_two_free_cores']:.0f} by CPU time; load {row['load_average']} (the paper: 10)"
        for row in rows
    ]


def views(rows: Rows) -> list[str]:
    """Return the lines of the section that compares empty-space skipping with brute force in several views."""
    lines = [f"  {'view':36} {'loads':>7} {'time':>7}  leap over brute force"]
    lines += [f"  {row['view'][:36]:36} {row['loads_ratio']:7.3f} {row['time_ratio']:7.3f}" for row in rows]
    return lines


def first_frame(rows: Rows) -> list[str]:
    """Return the lines of the section that measures the time from a volume in memory to the first picture."""
    lines = []
    for row in rows:
        wall = row["wall_ms"]
        parts = ", ".join(
            f"{key.replace('_', ' ')} {wall[key]['median']:.0f}" for key in ("look_at_values", "prepare", "picture")
        )
        lines.append(
            f"  {row['case'][:14]:14} {wall['whole']['median']:.0f} ms (least {wall['whole']['min']:.0f}; {parts}; "
            f"CPU time over {row['threads']} threads {row['cpu_ms_over_threads']:.0f}; load {row['load_average']})"
        )
    return lines


def paper(rows: Rows) -> list[str]:
    """Return the lines of the section that compares skipping with brute force in the paper's setting."""
    lines = [
        "  speed-up over brute force: automatic choice, forced leaps, steps; the paper: 1.7 to 3.0, error 0.0 %",
        f"  {'volume':14} {'transfer':8} {'view':15} {'auto':>6} {'forced':>6} {'(wall)':>6} {'steps':>6} "
        f"{'choice':>6} {'auto over better':>16} {'load':>5}  difference",
    ]
    lines += [
        f"  {row['volume'][:14]:14} {row['transfer']:8} {row['view']:15} {row['speed_up_time']:6.2f} "
        f"{row['speed_up_time_always']:6.2f} {row['speed_up_wall_always']:6.2f} {row['speed_up_steps']:6.2f} "
        f"{'leap' if row['automatic_leaps'] else 'brute':>6} {row['automatic_over_better']:16.2f} "
        f"{(row['load_average'] or [float('nan')])[0]:5.1f}  max {row['leap_minus_brute']['max']} on "
        f"{10_000 * row['leap_minus_brute']['share_of_pixels']:.2f} of 10,000 pixels"
        for row in rows
    ]
    return lines


def beside(rows: Rows) -> list[str]:
    """Return the lines of a section that compares one function of Carina with that of another program."""
    lines = []
    for row in rows:
        times = ", ".join(f"{key} {value['median']:.4g} ms" for key, value in row["cpu_ms"].items())
        more = f"; {row['bytes_per_voxel']} bytes a voxel" if row.get("bytes_per_voxel") is not None else ""
        ratio = row["ratio"]
        again = f"; called again {row['ratio_again']['median']:.2f}x" if "ratio_again" in row else ""
        lines.append(
            f"  {row['case'][:14]:14} {ratio['median']:.2f}x (least times: {ratio['min']:.2f}x{again})  {times}{more}"
        )
    return lines


def prepared(rows: Rows) -> list[str]:
    """Return the lines of the section that measures the time from CT values to the map, on all threads."""
    return [
        f"  {row['case'][:14]:14} {row['wall_ms']['median']:.0f} ms (least {row['wall_ms']['min']:.0f}); "
        f"CPU time {row['cpu_ms']['median']:.0f}"
        for row in rows
    ]


def memory(rows: Rows) -> list[str]:
    """Return the lines of the section that measures the server's peak memory."""
    return [
        f"  {row['case'][:14]:14} peak {row['peak_bytes'] / 2**20:.0f} MiB, {row['times_volume']:.2f} times the volume "
        f"({row['volume_bytes'] / 2**20:.0f} MiB); {row['peak_bytes_at_start'] / 2**20:.0f} MiB before a case"
        if row["peak_bytes"] is not None
        else f"  {row['case'][:14]:14} this system does not say"
        for row in rows
    ]
