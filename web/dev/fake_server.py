"""A stand-in for Carina's server, to look at the web client without a volume: synthetic pictures, a made-up tree.

    python web/dev/fake_server.py [--port 8765] [--scene start|opening|ready|not-hu|errors]

It speaks the wire of ``protocol/README.md`` through Carina's own message classes, so that a message that the real
server could not send cannot come from here either. Nothing it shows is anatomy.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
import uvicorn
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from carina.server import messages as wire
from carina.server.wire_codec import encode_picture

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "protocol" / "valid" / "server"
NAMES = ["Trachea", "RMB", "LMB", "RUL", "BI", "LUL", "LLL", "RB1", "RB2", "RML", "RLL", "LB1+2", "LB3", "LB6", "LB8"]

Array = NDArray[np.float64]


def sample(name: str) -> dict[str, Any]:
    """A golden message of the protocol, to be changed where the scene asks for it."""
    parsed: dict[str, Any] = json.loads((SAMPLES / f"{name}.json").read_text(encoding="utf-8"))
    return parsed


def make_tree(generations: int) -> dict[str, Any]:
    """A planar binary tree, trachea first."""
    branches: list[dict[str, Any]] = []

    def grow(parent: int | None, start: Array, *, angle: float, length: float, radius: float, generation: int) -> int:
        branch_id = len(branches)
        along = np.linspace(0, 1, 12)[:, None]
        bend = np.array([0.0, 0.12 * length * math.sin(generation), 0.0])
        end = start + length * np.array([math.sin(angle), 0.15, -math.cos(angle)])
        points = start + along * (end - start) + np.sin(along * math.pi) * bend
        points[0] = start
        branch = {
            "id": branch_id,
            "parent": parent,
            "children": [],
            "generation": generation,
            "name": NAMES[branch_id] if branch_id < len(NAMES) else None,
            "kind": "tracked",
            "points": points.tolist(),
            "radius": [radius] * len(points),
            "cost": None,
            "confidence": 0.8,
        }
        branches.append(branch)
        if generation < generations:
            for side in (-1, 1):
                spread = 0.6 if generation == 0 else 0.45
                child = grow(
                    branch_id,
                    points[-1],
                    angle=angle + side * spread,
                    length=0.72 * length,
                    radius=0.78 * radius,
                    generation=generation + 1,
                )
                branch["children"].append(child)
        return branch_id

    grow(None, np.array([0.0, -20.0, 60.0]), angle=0.0, length=90.0, radius=8.8, generation=0)
    return {"format": "carina-tree", "version": 1, "space": "LPS", "unit": "mm", "root": 0, "branches": branches}


def make_route(tree: dict[str, Any], branch_id: int) -> dict[str, Any]:
    """The way from the root to the end of a branch."""
    by_id = {branch["id"]: branch for branch in tree["branches"]}
    line: list[dict[str, Any]] = []
    node: dict[str, Any] | None = by_id[branch_id]
    while node is not None:
        line.insert(0, node)
        node = None if node["parent"] is None else by_id[node["parent"]]
    points: list[list[float]] = []
    generation: list[int] = []
    radius: list[float] = []
    spans: list[dict[str, Any]] = []
    for branch in line:
        skip = 1 if points else 0
        spans.append({"branch_id": branch["id"], "name": branch["name"], "generation": branch["generation"]})
        points += branch["points"][skip:]
        generation += [branch["generation"]] * (len(branch["points"]) - skip)
        radius += branch["radius"][skip:]
        spans[-1]["last"] = len(points) - 1
    steps = np.linalg.norm(np.diff(np.array(points), axis=0), axis=1)
    cumulative = [0.0, *np.cumsum(steps).tolist()]
    begin = 0.0
    for span in spans:
        span["from_mm"], span["to_mm"] = begin, cumulative[span.pop("last")]
        begin = span["to_mm"]
    return {
        "route_id": f"branch-{branch_id}",
        "title": line[-1]["name"] or f"branch {branch_id}, generation {line[-1]['generation']}",
        "target_id": None,
        "branch_id": branch_id,
        "points_lps": points,
        "cumulative_mm": cumulative,
        "generation": generation,
        "radius_mm": radius,
        "forks_mm": [span["to_mm"] for span in spans[:-1]],
        "spans": spans,
        "length_mm": cumulative[-1],
    }


def looking(at: Array, forward: Array) -> Array:
    """``lps_from_camera`` with anterior up."""
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, -1.0, 0.0])
    down = -(up - (up @ forward) * forward)
    down /= np.linalg.norm(down)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([np.cross(down, forward), down, forward])
    pose[:3, 3] = at
    return pose


class Station:
    """One connection's made-up session."""

    def __init__(self, socket: WebSocket, scene: str) -> None:
        self.socket = socket
        self.scene = scene
        self.tree = make_tree(5)
        self.route = make_route(self.tree, self.deepest())
        self.path_mm = 30.0
        self.look = [0.0, 0.0, 0.0]
        self.mode = "path"
        self.views: dict[str, tuple[int, int]] = {}
        self.pose_id = 1
        self.frame_id = 0
        self.state = sample(
            {"opening": "state-opening", "not-hu": "state-not-hu", "start": "state-empty"}.get(scene, "state-ready")
        )
        if self.state["case"] is not None:
            self.state["case"]["title"] = "Thorax 1.0 B60f, 3.0 mm"
        self.state |= {"transfer_presets": ["endoscopic", "ct-grey", "see-through", "paper"], "mode": self.mode}
        self.state["targets"] = [
            {"target_id": "t1", "name": "Target 1", "lps": [20.0, -5.0, -60.0], "used_lps": [21.0, -5.0, -60.0],
             "snapped_mm": 1.0, "length_mm": 143.0, "problem": None},
            {"target_id": "t2", "name": "Target 2", "lps": [60.0, 30.0, -60.0], "used_lps": None, "snapped_mm": None,
             "length_mm": None, "problem": "no airway within 5 mm: the nearest is 12.4 mm away"},
        ]  # fmt: skip
        self.dirty = asyncio.Event()

    def deepest(self) -> int:
        """A leaf on the patient's right."""
        return max(b["id"] for b in self.tree["branches"] if not b["children"] and b["points"][-1][0] < -10)

    def pose(self) -> Array:
        """Camera on the route, turned by the free look."""
        points = np.array(self.route["points_lps"])
        at_mm = np.array(self.route["cumulative_mm"])
        here = np.array([np.interp(self.path_mm, at_mm, points[:, axis]) for axis in range(3)])
        ahead = np.array([np.interp(self.path_mm + 4, at_mm, points[:, axis]) for axis in range(3)])
        behind = np.array([np.interp(self.path_mm - 4, at_mm, points[:, axis]) for axis in range(3)])
        pose = looking(here, ahead - behind)
        yaw, pitch, roll = self.look
        cy, sy, cp, sp, cr, sr = (f(v) for v in (yaw, pitch, roll) for f in (math.cos, math.sin))
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
        pose[:3, :3] = pose[:3, :3] @ about_y @ about_x @ about_z
        return pose

    async def send(self, message: dict[str, Any]) -> None:
        """Through the real parser: the client must not be shown what cannot happen."""
        text = json.dumps(message)
        wire.parse_server_message(text)
        await self.socket.send_text(text)

    async def send_pose(self) -> None:
        span = next((s for s in self.route["spans"] if self.path_mm < s["to_mm"]), self.route["spans"][-1])
        await self.send(
            {"type": "pose", "pose_id": self.pose_id, "lps_from_camera": self.pose().ravel().tolist(),
             "mode": self.mode, "path_mm": self.path_mm if self.mode == "path" else None,
             "branch_id": span["branch_id"], "branch_name": span["name"],
             "generation": span["generation"], "lumen_mm": 9.4, "inside": True}
        )  # fmt: skip

    async def greet(self) -> None:
        await self.send(sample("hello"))
        start = sample("start")
        start["notice_accepted"] = self.scene != "start"
        await self.send(start)
        await self.send(self.state)
        if self.state["case"] is None:
            return
        if self.scene == "opening":
            await self.send(sample("progress"))
        elif self.scene != "not-hu":
            await self.send({"type": "tree", "tree": self.tree})
            await self.send({"type": "route", "route": self.route})
        if self.scene == "errors":
            await self.send(sample("error"))
            await self.send(sample("notice"))
        await self.send(sample("status"))
        await self.send_pose()

    async def receive(self, message: dict[str, Any]) -> None:
        changed = True
        match message["type"]:
            case "layout":
                self.views = {v["view"]: (v["width"], v["height"]) for v in message["views"]}
            case "steer":
                self.path_mm = min(max(self.path_mm + message["advance_mm"], 0), self.route["length_mm"])
                for index, name in enumerate(("yaw_rad", "pitch_rad", "roll_rad")):
                    self.look[index] += message[name]
            case "go_to":
                self.path_mm = message["path_mm"]
            case "next_fork":
                self.path_mm = next(
                    (f for f in self.route["forks_mm"] if f > self.path_mm + 0.5), self.route["length_mm"]
                )
            case "previous_fork":
                self.path_mm = max([0.0, *(f for f in self.route["forks_mm"] if f < self.path_mm - 0.5)])
            case "reset_look":
                self.look = [0.0, 0.0, 0.0]
            case "toggle_mode":
                self.mode = "free" if self.mode == "path" else "path"
            case "set_mode":
                self.mode = message["mode"]
            case "set_crosshair":
                self.state["crosshair_lps"] = message["lps"]
            case "set_window":
                self.state["window"] = {"width_hu": message["width_hu"], "level_hu": message["level_hu"]}
            case "choose_route":
                if message["branch_id"] is not None:
                    self.route = make_route(self.tree, message["branch_id"])
                    self.path_mm = min(self.path_mm, self.route["length_mm"])
                    await self.send({"type": "route", "route": self.route})
            case "open_demo" | "open_path" | "open_recent":
                self.scene = "ready"
                self.state |= {
                    key: value for key, value in sample("state-ready").items() if key in {"case", "stage", "airways"}
                }
                await self.send({"type": "tree", "tree": self.tree})
                await self.send({"type": "route", "route": self.route})
            case "close_case":
                self.state |= sample("state-empty")
            case _:
                changed = False
        if changed:
            self.state["mode"] = self.mode
            self.pose_id += 1
            await self.send(self.state)
            if self.state["case"] is not None:
                await self.send_pose()
            self.dirty.set()

    async def paint(self) -> None:
        """Draws all visible views whenever something has changed; the newest pose only."""
        while True:
            await self.dirty.wait()
            self.dirty.clear()
            if self.state["case"] is None:
                continue
            for view, (width, height) in list(self.views.items()):
                if view == "tree" and self.scene in {"opening", "not-hu"}:
                    continue
                await self.socket.send_bytes(self.picture(view, width, height))
                await asyncio.sleep(0)

    def picture(self, view: str, width: int, height: int) -> bytes:
        pose = self.pose()
        tip = pose[:3, 3]
        centre = np.array(self.state["crosshair_lps"] or tip)
        self.frame_id += 1
        header: dict[str, Any] = {
            "frame_id": self.frame_id, "view": view, "pose_id": self.pose_id, "lps_from_camera": None, "fov_deg": None,
            "lps_from_pixel": None, "width": width, "height": height, "codec": "jpeg", "quality": 95, "full": True,
            "render_ms": 4.0, "method": "fake",
        }  # fmt: skip
        rows, columns = np.mgrid[0:height, 0:width] + 0.5
        if view in {"airway", "tree", "tri-plane"}:
            camera = pose if view == "airway" else looking(np.array([0.0, -330.0, -40.0]), np.array([0.0, 1.0, 0.001]))
            if view != "airway":
                camera[:3, :3] = np.column_stack([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
            header |= {"lps_from_camera": camera.ravel().tolist(), "fov_deg": 90.0 if view == "airway" else 45.0}
            rgb = tunnel(rows, columns, self.path_mm) if view == "airway" else np.full((height, width, 3), 12, np.uint8)
        else:
            axes = {
                "axial": ([1, 0, 0], [0, 1, 0]), "coronal": ([1, 0, 0], [0, 0, -1]),
                "sagittal": ([0, 1, 0], [0, 0, -1]), "cut-plane": (pose[:3, 0], pose[:3, 1]),
                "xray-axial": ([1, 0, 0], [0, 1, 0]),
                "xray-coronal": ([1, 0, 0], [0, 0, -1]), "xray-sagittal": ([0, 1, 0], [0, 0, -1]),
            }[view]  # fmt: skip
            mm = (60.0 if view == "cut-plane" else 300.0) / min(width, height)
            right, down = (np.array(axis, dtype=float) for axis in axes)
            middle = centre if view == "cut-plane" else centre * 0.3 + np.array([0.0, 0.0, -30.0])
            middle = middle + (centre - middle) @ np.cross(right, down) * np.cross(right, down)
            matrix = np.eye(4)
            matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right * mm, down * mm, np.cross(right, down)
            matrix[:3, 3] = middle - right * mm * width / 2 - down * mm * height / 2
            header["lps_from_pixel"] = matrix.ravel().tolist()
            rgb = body(rows, columns, mm)
        parsed = {key: tuple(value) if isinstance(value, list) else value for key, value in header.items()}
        jpeg = simplejpeg.encode_jpeg(np.ascontiguousarray(rgb), quality=90, colorspace="RGB", colorsubsampling="444")
        return encode_picture(wire.PictureHeader(**parsed), jpeg)


def tunnel(rows: Array, columns: Array, path_mm: float) -> NDArray[np.uint8]:
    """Rings that come nearer while the tip advances."""
    height, width = rows.shape
    radius = np.hypot(columns - width / 2, rows - height / 2) / (min(width, height) / 2) + 1e-3
    depth = 1 / radius
    light = np.clip(1.15 - 0.16 * depth, 0.02, 1) * (0.88 + 0.12 * np.cos(2.2 * (6 * depth + path_mm)))
    return (np.clip(light, 0, 1)[..., None] * np.array([236, 168, 150])).astype(np.uint8)


def body(rows: Array, columns: Array, mm: float) -> NDArray[np.uint8]:
    """An ellipse with two dark lungs."""
    height, width = rows.shape
    x = (columns - width / 2) * mm
    y = (rows - height / 2) * mm
    grey = np.where((x / 140) ** 2 + (y / 105) ** 2 < 1, 170.0, 8.0)
    for side in (-1, 1):
        grey = np.where(
            ((x - side * 62) / 50) ** 2 + (y / 78) ** 2 < 1, 58.0 + 6 * np.sin(x * 0.4) * np.cos(y * 0.5), grey
        )
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def main() -> None:
    """Serve the built client and one made-up session per connection."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=8765)
    parser.add_argument("--scene", default="ready", choices=["start", "opening", "ready", "not-hu", "errors"])
    options = parser.parse_args()

    async def connect(socket: WebSocket) -> None:
        await socket.accept()
        station = Station(socket, options.scene)
        painter = asyncio.create_task(station.paint())
        try:
            while True:
                message = json.loads(await socket.receive_text())
                wire.parse_client_message(json.dumps(message))
                if message["type"] == "hello":
                    await station.greet()
                else:
                    await station.receive(message)
        except WebSocketDisconnect:
            pass
        finally:
            painter.cancel()

    static = StaticFiles(directory=ROOT / "python" / "carina" / "_web", html=True)
    app = Starlette(routes=[WebSocketRoute("/ws", connect), Mount("/", static)])
    uvicorn.run(app, host="127.0.0.1", port=options.port, ws="websockets-sansio", log_level="warning")


if __name__ == "__main__":
    main()
