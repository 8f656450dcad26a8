"""Test of key frames over the wire: the list, the flight, and their file over HTTP."""

from __future__ import annotations

from live_server import open_case

from carina.server.wire import messages as wire


def edit(window, change):
    window.send(wire.EditKeyFrames(change))


def until(window, kind, wanted=lambda _message: True):
    return window.until(lambda m: isinstance(m, kind) and wanted(m))


def test_key_frames_are_edited_flown_downloaded_and_opened_again(live):
    with live.window() as window, live.http(cookie=live.cookie, origin=live.origin) as http:
        with live.http() as client:
            assert client.get("/api/key-frames.json").status_code == 401
        assert http.get("/api/key-frames.json").status_code == 409
        open_case(window)
        none = http.get("/api/key-frames.json")
        assert none.status_code == 409
        assert "no key frames" in none.json()["message"]
        window.send(wire.GoTo(1.0))
        edit(window, wire.KeyFrameAdd())
        window.send(wire.GoTo(20.0))
        edit(window, wire.KeyFrameAdd())
        keys = until(window, wire.KeyFramesMessage, lambda m: len(m.frames) == 2)
        first, second = keys.frames
        assert second.through_airways
        assert keys.duration_s == second.time_s > 0.0
        edit(window, wire.KeyFrameRename(second.key_id, "here"))
        edit(window, wire.KeyFrameSpeed(second.key_id, 5.0))
        edit(window, wire.KeyFrameMove(first.key_id, 1))
        edit(window, wire.KeyFrameUpdate(first.key_id))
        window.send(wire.SetKeyFrameFlight(10.0, "space"))
        keys = until(window, wire.KeyFramesMessage, lambda m: m.through == "space")
        assert [(key.name, key.speed_mm_s) for key in keys.frames] == [("here", 5.0), ("Trachea", None)]
        window.send(wire.ShowKeyFrame(second.key_id))
        until(window, wire.PoseMessage, lambda m: m.key_frames_s == 0.0)
        edit(window, wire.KeyFrameUpdate("key-99"))
        assert "has been removed" in until(window, wire.Error).message

        window.send(wire.SetKeyFrameFlight(None, "airways"))
        window.send(wire.GoTo(2.0))
        edit(window, wire.KeyFrameUpdate(first.key_id))
        lasts = until(window, wire.KeyFramesMessage, lambda m: m.duration_s > 0.5).duration_s
        window.send(wire.FlyKeyFrames(lasts / 2, False))
        until(window, wire.PoseMessage, lambda m: m.key_frames_s == lasts / 2)
        answer = http.get("/api/key-frames.json")
        assert answer.headers["content-disposition"] == 'attachment; filename="key-frames.json"'
        assert (answer.json()["format"], answer.json()["version"]) == ("carina-keys", 2)

        for key in keys.frames:
            edit(window, wire.KeyFrameRemove(key.key_id))
        until(window, wire.KeyFramesMessage, lambda m: not m.frames)
        # The paths are computed again in the present airways.
        document = answer.json()
        for key in document["keys"]:
            key["way"] = None
        upload_id = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload_id}?name=k.json", json=document).status_code == 201
        window.send(wire.OpenKeyFrames(upload_id))
        opened = until(window, wire.KeyFramesMessage, lambda m: len(m.frames) == 2)
        assert opened.duration_s == lasts
        until(window, wire.Done)
        window.send(wire.OpenKeyFrames(upload_id))
        assert "has expired" in until(window, wire.Error).message, "the read file is not stored"
