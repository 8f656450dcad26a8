"""Key frames over the wire: the list, the flight, and its file by HTTP, on loopback."""

from __future__ import annotations

from live_server import open_case

from carina.server import messages as wire


def edit(window, change):
    window.send(wire.EditKeys(change))


def until(window, kind, wanted=lambda _message: True):
    return window.until(lambda m: isinstance(m, kind) and wanted(m))


def test_key_frames_are_edited_flown_taken_away_and_opened_again(live):
    with live.window() as window, live.http(cookie=live.cookie, origin=live.origin) as http:
        with live.http() as stranger:
            assert stranger.get("/api/key-frames.json").status_code == 401
        assert http.get("/api/key-frames.json").status_code == 409
        open_case(window)
        none = http.get("/api/key-frames.json")
        assert none.status_code == 409
        assert "no key frames" in none.json()["message"]
        window.send(wire.GoTo(1.0))
        edit(window, wire.KeyAdd())
        window.send(wire.GoTo(20.0))
        edit(window, wire.KeyAdd())
        keys = until(window, wire.Keys, lambda m: len(m.keys) == 2)
        first, second = keys.keys
        assert second.through_airways
        assert keys.duration_s == second.time_s > 0.0
        edit(window, wire.KeyRename(second.key_id, "here"))
        edit(window, wire.KeySpeed(second.key_id, 5.0))
        edit(window, wire.KeyMove(first.key_id, 1))
        edit(window, wire.KeyUpdate(first.key_id))
        window.send(wire.SetKeyFlight(10.0, "space"))
        keys = until(window, wire.Keys, lambda m: m.through == "space")
        assert [(key.name, key.speed_mm_s) for key in keys.keys] == [("here", 5.0), ("Trachea", None)]
        window.send(wire.ShowKey(second.key_id))
        until(window, wire.Pose, lambda m: m.keys_s == 0.0)
        edit(window, wire.KeyUpdate("key-99"))
        assert "has been removed" in until(window, wire.Error).message

        window.send(wire.SetKeyFlight(None, "airways"))
        window.send(wire.GoTo(2.0))
        edit(window, wire.KeyUpdate(first.key_id))
        lasts = until(window, wire.Keys, lambda m: m.duration_s > 0.5).duration_s
        window.send(wire.FlyKeys(lasts / 2, False))
        until(window, wire.Pose, lambda m: m.keys_s == lasts / 2)
        answer = http.get("/api/key-frames.json")
        assert answer.headers["content-disposition"] == 'attachment; filename="key-frames.json"'
        assert (answer.json()["format"], answer.json()["version"]) == ("carina-keys", 2)

        for key in keys.keys:
            edit(window, wire.KeyRemove(key.key_id))
        until(window, wire.Keys, lambda m: not m.keys)
        # The ways are found anew, in the airways that there are then.
        document = answer.json()
        for key in document["keys"]:
            key["way"] = None
        upload_id = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload_id}?name=k.json", json=document).status_code == 201
        window.send(wire.OpenKeys(upload_id))
        opened = until(window, wire.Keys, lambda m: len(m.keys) == 2)
        assert opened.duration_s == lasts
        until(window, wire.Done)
        window.send(wire.OpenKeys(upload_id))
        assert "has expired" in until(window, wire.Error).message, "what was read is not kept"
