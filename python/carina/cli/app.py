"""The commands. Each command is thin: it parses arguments, calls a public function and prints."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import carina
from carina.cli.app_airways import airways, export, plan, track
from carina.cli.app_case import case
from carina.cli.app_cluster import cluster
from carina.cli.app_dicom import deidentify
from carina.cli.app_pacs import pacs
from carina.cli.app_training import course, insert, score
from carina.cli.arguments import check_needs, check_output_folder, check_window_path, parse_point, parse_size
from carina.cli.console import (
    accept_any_text,
    end_with_error,
    exit_codes,
    log_to_terminal,
    print_json,
    print_result,
    print_usage_error,
    progress_printer,
)
from carina.cli.options import CtOption, JsonOption, PathArgument, SeriesOption, StrictOption, TokenOption
from carina.display.escaped_text import printable
from carina.display.progress import without_bars
from carina.errors import UsageError


class CarinaCommands(TyperGroup):
    """The commands of ``carina``; an empty argument is refused for all of them."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an empty argument: as a path it would be the present folder."""
        for number, word in enumerate(args):
            name, sign, value = word.partition("=")
            if not word.strip() or (name.startswith("--") and sign and not value.strip()):
                before = args[number - 1] if number and not sign else name
                place = f"{before}: " if before.startswith("-") else ""
                raise typer.BadParameter(f"{place}expected a value; found an empty text", ctx=ctx)
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=CarinaCommands,
    help="Virtual bronchoscopy: fly through the airways of a chest CT. Not a medical device.",
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
)

PortOption = Annotated[int, typer.Option(help="Port to listen on; 0 chooses a free one.", min=0, max=65535)]
HostOption = Annotated[
    str,
    typer.Option(
        help=("Address to listen on. Any address other than loopback makes the case reachable from the network.")
    ),
]
BrowserOption = Annotated[bool, typer.Option("--browser/--no-browser", help="Open the workstation in the browser.")]


ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster", help="Render on a cluster: HOST:PORT of its head node, or local (a trial cluster on this machine)."
    ),
]
MixedOption = Annotated[
    bool,
    typer.Option(
        "--mixed", help=("Let the machines in the cluster use their GPUs; images may then differ by one grey level.")
    ),
]


PhoneOption = Annotated[
    bool,
    typer.Option(
        "--phone",
        help=(
            "Start with the phone page available on the local network. Anyone with its link can move the tip, but "
            "cannot see the case."
        ),
    ),
]
PhoneAddressOption = Annotated[
    str | None,
    typer.Option(
        "--phone-address",
        help=("Address for the phone page to listen on (default: this machine's address on the local network)."),
    ),
]


def _workstation(
    *,
    path: Path | None,
    demo: str | None,
    host: str,
    port: int,
    browser: bool,
    as_json: bool,
    cluster: str | None = None,
    token: Path | None = None,
    mixed: bool = False,
    phone: bool = False,
    phone_address: str | None = None,
    ct: Path | None = None,
    strict: bool = False,
) -> None:
    changes: dict[str, Any] = {}

    def phone_open(url: str, sha256: str) -> None:
        changes["phone"] = {"url": url, "sha256": sha256}

    def ready(url: str, token: str) -> None:
        if as_json:
            # The link is for a browser of this user; the token is for programs and lasts as long as the server.
            print_json({"url": url, "token": token, **changes})
            return
        if "phone" in changes:
            print_result(
                f"Open on the phone: {changes['phone']['url']}",
                f"Certificate fingerprint (SHA-256): {changes['phone']['sha256']}",
            )
        print_result(f"Carina is open at {url}", "Press Ctrl-C to close it.", flush=True)

    with exit_codes(as_json):
        from carina.cli.case_ids import path_or_case, stored_case
        from carina.cli.cluster import opened_cluster
        from carina.phone import PhoneSwitch
        from carina.server import serve

        if cluster is None:
            check_needs("a cluster (--cluster)", mixed=mixed, token_file=token)
        if not phone:
            check_needs("the phone page (--phone)", phone_address=phone_address)
        check_window_path(path)
        check_window_path(ct)
        record = None if path is None else stored_case(path)
        if ct is not None:
            from carina.cli.opened import check_case_options

            path = path if record is None else path_or_case(path)
            record = None

            if path is None:
                raise UsageError("--ct only applies to a case file (NAME.carina)")
            check_case_options(path, ct)
        if strict and path is not None:
            from carina.cli.opened import open_input

            # The window reads the scan again; a refused scan never appears in it.
            open_input(path_or_case(path) or path, series=None, strict=True, progress=progress_printer(), ct=ct)
        with opened_cluster(cluster, token=token, mixed=mixed) as used:
            code = serve(
                str(path) if path is not None and record is None else None,
                ct=ct,
                case_id=None if record is None else record.case_id,
                demo=demo,
                host=host,
                port=port,
                open_browser=browser,
                on_ready=ready,
                phone=phone,
                phone_address=phone_address,
                on_phone=phone_open,
                make_phone=PhoneSwitch,
                make_renderer=None if used is None else used.make_renderer,
                cluster_status=None if used is None else used.status,
            )
        raise SystemExit(code)


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Virtual bronchoscopy: fly through the airways of a chest CT. Not a medical device.

    Without a command, open the workstation's start page.
    """
    if version:
        print_result(f"carina {carina.__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        _workstation(path=None, demo=None, host="127.0.0.1", port=0, browser=True, as_json=False)


@app.command("open")
def open_(
    path: Annotated[
        Path | None,
        typer.Argument(help="CT folder or file, case file, or the id of a stored case (default: open the start page)."),
    ] = None,
    port: PortOption = 0,
    host: HostOption = "127.0.0.1",
    browser: BrowserOption = True,
    cluster_: ClusterOption = None,
    mixed: MixedOption = False,
    token_file: TokenOption = None,
    phone: PhoneOption = False,
    phone_address: PhoneAddressOption = None,
    ct: CtOption = None,
    strict: StrictOption = False,
    as_json: JsonOption = False,
) -> None:
    """Open the workstation on a CT, or on a case file (NAME.carina).

    Example: carina open ~/scans/thorax
    """
    _workstation(
        path=path,
        demo=None,
        host=host,
        port=port,
        browser=browser,
        as_json=as_json,
        cluster=cluster_,
        token=token_file,
        mixed=mixed,
        phone=phone,
        phone_address=phone_address,
        ct=ct,
        strict=strict,
    )


@app.command()
def demo(
    name: Annotated[str, typer.Argument(help="Bundled case to open: phantom or patient.")] = "phantom",
    port: PortOption = 0,
    host: HostOption = "127.0.0.1",
    browser: BrowserOption = True,
    phone: PhoneOption = False,
    phone_address: PhoneAddressOption = None,
    as_json: JsonOption = False,
) -> None:
    """Open the workstation on a bundled case; nothing to download.

    Example: carina demo patient
    """
    with exit_codes(as_json):
        if name not in {"phantom", "patient"}:
            raise UsageError(f"demo: expected phantom or patient; found {name!r}")
    _workstation(
        path=None,
        demo=name,
        host=host,
        port=port,
        browser=browser,
        as_json=as_json,
        phone=phone,
        phone_address=phone_address,
    )


@app.command()
def info(
    path: PathArgument,
    strict: StrictOption = False,
    series: SeriesOption = None,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the geometry, value range, series and quality findings of a CT.

    Example: carina info ~/scans/thorax --json
    """
    with exit_codes(as_json):
        from carina.cli.info import report

        raise SystemExit(report(path, strict=strict, series=series, as_json=as_json, ct=ct))


for verb in (airways, export, track, plan, deidentify):
    app.command()(verb)


@app.command()
def render(
    path: PathArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="PNG file to write.")],
    view: Annotated[
        str | None,
        typer.Option(
            help="View to render: airway (default), cut-plane, axial, tree, ..., xray-set for the three X-rays "
            "side by side, or forks for all forks of a route (--to); any unknown name lists the others."
        ),
    ] = None,
    at: Annotated[
        str,
        typer.Option(
            help="Tip position x,y,z in mm (LPS), or auto for the top of the trachea "
            "(default for a case: its last tip position)."
        ),
    ] = "auto",
    look: Annotated[str | None, typer.Option(help="Viewing direction dx,dy,dz in LPS (default: caudal).")] = None,
    up: Annotated[
        str | None, typer.Option(help=("Direction dx,dy,dz that points up in the image (default: anterior)."))
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option(
            help="Full field of view across the shorter side, 1 to 170 degrees (default: the scope's, or 90)."
        ),
    ] = None,
    scope: Annotated[
        str | None, typer.Option(help="Scope to simulate: generic, standard, ultrathin, ebus, ... or none.")
    ] = None,
    lens: Annotated[
        str | None, typer.Option(help="Lens: pinhole, equidistant, or an OpenCV calibration file (.yml, .xml, .json).")
    ] = None,
    outline: Annotated[
        str | None,
        typer.Option(
            help="Crop the image to a round or octagonal field (round, octagon), or keep the full frame (none)."
        ),
    ] = None,
    mask: Annotated[
        str | None, typer.Option("--mask", hidden=True, help="Former name of --outline; still accepted.")
    ] = None,
    vignette: Annotated[
        float | None, typer.Option(help="Vignetting, from 0 (none) to 1 (the natural light fall-off of the lens).")
    ] = None,
    focus: Annotated[
        str | None,
        typer.Option(
            help=("Depth of field: near,far in mm, or scope for the scope's own range; anything outside is blurred.")
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Image size, WxH in pixels.")] = "512x512",
    method: Annotated[
        str,
        typer.Option(
            help=(
                "Ray method: leap skips empty space (fast), brute samples every step (for reference). Both give "
                "the same image."
            )
        ),
    ] = "leap",
    step_vox: Annotated[float, typer.Option(help="Ray step, in multiples of the smallest voxel spacing.")] = 0.5,
    transfer: Annotated[
        str | None,
        typer.Option(help=("Transfer function: a preset (endoscopic, paper, ct-grey, see-through) or a JSON file.")),
    ] = None,
    shading: Annotated[
        str | None, typer.Option(help="Shading of the airway wall: on or off (default: on, or as in the case).")
    ] = None,
    texture: Annotated[
        str | None,
        typer.Option(
            help="Decoration of the airway wall (rings, vessels, fine texture; not from the CT): on or off "
            "(default: on, or as in the case)."
        ),
    ] = None,
    orbit: Annotated[
        str | None,
        typer.Option(
            help=("Camera position for the tri-plane and tree views: azimuth,elevation,distance (degrees, mm).")
        ),
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(help="Window width,level in HU (default: 1500,-600 for planes; fitted to the image for X-rays)."),
    ] = None,
    surface: Annotated[
        Path | None,
        typer.Option(
            help=("NPZ file to write for an airway view: depth, position and normal of the wall at each pixel.")
        ),
    ] = None,
    tree: Annotated[
        Path | None,
        typer.Option(help=("Airway tree file for the straightened and curved views (default: segment the scan).")),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            help=(
                "End of the route for the straightened and curved views: a branch name or id, "
                "or a point x,y,z in mm (LPS)."
            )
        ),
    ] = None,
    turn: Annotated[
        float,
        typer.Option(
            help=("Rotation of the cutting plane about the path in the straightened and curved views, in degrees.")
        ),
    ] = 0.0,
    carm_primary: Annotated[
        float,
        typer.Option(
            help="C-arm angle of the simulated X-ray (drr) in degrees: LAO positive, RAO negative; 90 is lateral."
        ),
    ] = 0.0,
    carm_secondary: Annotated[
        float,
        typer.Option(help="C-arm tilt of the simulated X-ray (drr) in degrees: cranial positive, caudal negative."),
    ] = 0.0,
    tone: Annotated[
        str,
        typer.Option(help=("Style of the simulated X-ray (drr): radiograph (bone white) or fluoroscopy (bone dark).")),
    ] = "radiograph",
    slab: Annotated[
        str | None,
        typer.Option(help="Slab thickness in mm and projection (min, max or mean); for example, 10,min shows airways."),
    ] = None,
    letters: Annotated[
        str | None,
        typer.Option(
            help="Orientation letters at the edges: on or off (default: on for views along a path and for drr)."
        ),
    ] = None,
    scale_bar: Annotated[
        str | None,
        typer.Option(help="Scale in mm, or the axis of a path: on or off (default: on for views along a path)."),
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(help="Names of the branches: on or off (default: on for views along a path)."),
    ] = None,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Render one image of one view.

    Example: carina render ~/scans/thorax --view airway --at -2,15,-120 --look 0,0,-1 --size 768x768 -o carina.png
    """
    with exit_codes(as_json):
        from carina.cli.optics import OpticsOptions
        from carina.cli.render import report
        from carina.render import LEAD_VIEW

        if outline is not None:
            check_needs("images without --outline, its present name", mask=mask)
        switches = {
            "--shading": shading,
            "--texture": texture,
            "--letters": letters,
            "--scale-bar": scale_bar,
            "--names": names,
        }
        for what, switch in switches.items():
            if switch not in {None, "on", "off"}:
                raise UsageError(f"{what}: expected on or off; found {switch!r}")
        raise SystemExit(
            report(
                path,
                output=output,
                view=LEAD_VIEW if view is None else view,
                at=None if at == "auto" else parse_point(at, "--at"),
                look=None if look is None else parse_point(look, "--look"),
                up=None if up is None else parse_point(up, "--up"),
                fov_deg=fov,
                seen=OpticsOptions(scope=scope, lens=lens, outline=outline or mask, vignette=vignette, focus=focus),
                size=parse_size(size),
                method=method,
                step_vox=step_vox,
                transfer=transfer,
                shading=None if shading is None else shading == "on",
                texture=None if texture is None else texture == "on",
                orbit=orbit,
                window=window,
                surface=surface,
                tree=tree,
                to=to,
                turn_deg=turn,
                carm_deg=(carm_primary, carm_secondary),
                tone=tone,
                slab=slab,
                letters=None if letters is None else letters == "on",
                scale_bar=None if scale_bar is None else scale_bar == "on",
                names=None if names is None else names == "on",
                series=series,
                strict=strict,
                ct=ct,
                as_json=as_json,
            )
        )


@app.command()
def isoregion(
    path: PathArgument,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Map to write, on the scan's grid: .nii.gz, .nii, .nrrd or .mha."),
    ] = None,
    with_scan: Annotated[
        bool,
        typer.Option(
            "--with-scan",
            help=(
                "Write the scan and its map to one file (.nrrd), which Carina and other programs open as the scan, and "
                "from which --map reads the map."
            ),
        ),
    ] = False,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="Map that was written earlier: check that it belongs to the scan, and describe it."),
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(
            help=(
                "Compare voxels as this transfer function shows them: a preset (endoscopic, paper, ct-grey, "
                "see-through) or a JSON file (default: by value, see --equal-by)."
            )
        ),
    ] = None,
    equal_by: Annotated[
        str,
        typer.Option(
            "--equal-by",
            help=(
                "Without --transfer: values compares voxels by value, as in the paper (at most 256 different values); "
                "bins compares bins of 16; auto takes values if there are at most 256, else bins."
            ),
        ),
    ] = "auto",
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the IsoRegion map of a scan: for each voxel, the radius of the largest cube of equal voxels around it.

    See section 4 of the paper.

    Example: carina isoregion ~/scans/thorax --transfer endoscopic -o map.nrrd

    Example: carina isoregion ~/scans/thorax --transfer endoscopic --map map.nrrd

    Example: carina isoregion ~/scans/thorax -o thorax.nrrd --with-scan
    """
    with exit_codes(as_json):
        from carina.cli.isoregion import write

        raise SystemExit(
            write(
                path,
                output=output,
                with_scan=with_scan,
                map_file=map_file,
                transfer=transfer,
                equal_by=equal_by,
                series=series,
                strict=strict,
                ct=ct,
                as_json=as_json,
            )
        )


@app.command()
def phantom(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write the files to.")],
    seed: Annotated[int, typer.Option(help="Random seed; the same seed always gives the same case.", min=0)] = 0,
    spacing_mm: Annotated[float, typer.Option("--spacing-mm", help="Voxel spacing in mm.")] = 0.8,
    generations: Annotated[int, typer.Option(help="Deepest airway generation (the trachea is 0).")] = 6,
    stenosis: Annotated[bool, typer.Option("--stenosis", help="Add a stenosis to one bronchus.")] = False,
    nodule: Annotated[bool, typer.Option("--nodule", help="Add a nodule.")] = False,
    neck: Annotated[
        bool, typer.Option("--neck", help="Include the neck: larynx and throat above the cricoid.")
    ] = False,
    tube: Annotated[
        str | None, typer.Option(help="Add a tube in the trachea: endotracheal, or tracheostomy (needs --neck).")
    ] = None,
    resected: Annotated[
        str | None, typer.Option(help="Remove a lobe, as after a lobectomy: RUL, RML, RLL, LUL or LLL.")
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(
            help="Anatomical variant: tracheal-bronchus, subsuperior, absent-rb7, trifurcations, left-isomerism, or "
            "published (by seed, with the published frequencies)."
        ),
    ] = None,
    lesion: Annotated[
        str | None, typer.Option(help="Add a lesion to one bronchus: tumour, mucus, bleeding or foreign-body.")
    ] = None,
    mr: Annotated[
        bool, typer.Option("--mr", help="Write an MR picture of the chest, mr.nii.gz (not in HU), instead of a CT.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Generate a synthetic chest CT with exact ground truth: ct.nii.gz, lumen.nii.gz, truth.json.

    Example: carina phantom -o case --seed 7 --nodule
    """
    with exit_codes(as_json):
        from carina.errors import UsageError
        from carina.phantom import generate_mr_phantom, generate_phantom, write_phantom

        check_output_folder(output)
        changes = {"stenosis": stenosis, "nodule": nodule, "neck": neck, "tube": tube, "resected": resected}
        changes |= {"variant": variant, "lesion": lesion}
        chosen = [f"--{name}" for name, value in changes.items() if value]
        if mr and chosen:
            msg = f"--mr: expected a chest without {', '.join(chosen)}; leave one of the two out"
            raise UsageError(msg, code="phantom.option")
        if mr:
            made = generate_mr_phantom(
                seed=seed, spacing_mm=spacing_mm, generations=generations, progress=progress_printer()
            )
        else:
            made = generate_phantom(
                seed=seed,
                spacing_mm=spacing_mm,
                generations=generations,
                stenosis=stenosis,
                nodule=nodule,
                neck=neck,
                tube=tube,
                resected=resected,
                variant=variant,
                lesion=lesion,
                progress=progress_printer(),
            )
        written = write_phantom(made, output)
        summary: dict[str, Any] = {
            "files": [str(file) for file in written],
            "shape_zyx": list(made.volume.shape_zyx),
            "spacing_mm": list(made.volume.spacing_mm),
            "branches": len(made.truth["branches"]),
        }
        if as_json:
            print_json(summary)
        else:
            print_result(f"{summary['branches']} branches, {made.volume!r}")
            print_result(*map(printable, summary["files"]))


@app.command()
def doctor(as_json: JsonOption = False) -> None:
    """Show which components are installed, in use or missing, and how to install the missing ones.

    Example: carina doctor
    """
    with exit_codes(as_json):
        from carina.cli.doctor import report

        raise SystemExit(report(as_json=as_json))


@app.command()
def fly(
    path: PathArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Video file to write: .mp4 (H.264) or .webm (VP9).")],
    tree: Annotated[
        Path | None, typer.Option("--tree", help="Airway tree file written by carina (default: segment the scan).")
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(help="Destination: a branch name or id, a target of the case, or a point x,y,z in mm (LPS)."),
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="Replay a recorded flight: a file, or its name in the case.")
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            help=(
                "Key frames to fly through: a carina-keys JSON file saved in the window; for a case, all or their "
                "names, separated by commas."
            )
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Image size, WxH in pixels.")] = "512x512",
    rate: Annotated[float, typer.Option(help="Frames per second, 1 to 240.")] = 30.0,
    speed: Annotated[
        float, typer.Option(help=("Speed along the route in mm/s; key frames have their own speeds."))
    ] = 20.0,
    pause: Annotated[float, typer.Option(help="Pause at each fork and at the end, in seconds.")] = 1.0,
    scope: Annotated[
        str | None, typer.Option(help="Scope to simulate, or none. A recording contains its scope.")
    ] = None,
    step_vox: Annotated[float, typer.Option(help="Ray step, in multiples of the smallest voxel spacing.")] = 0.5,
    captions: Annotated[
        bool, typer.Option("--captions", help="Write time, branch, depth and the next turn with its clock hour.")
    ] = False,
    breathing: Annotated[
        str | None,
        typer.Option(
            help="Simulate breathing: quiet (12 mm every 3.6 s), or the amplitude at the lung bases in mm and the "
            "period in s, such as 18,5. Each frame states it."
        ),
    ] = None,
    cough: Annotated[
        str | None, typer.Option(help="With --breathing: times in s at which the patient coughs, such as 2.5,7.")
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder that stores the frames, so that an interrupted video can be continued."),
    ] = None,
    cluster: ClusterOption = None,
    mixed: MixedOption = False,
    token_file: TokenOption = None,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Render a fly-through video: to a branch or point, from a recording, or through key frames.

    Example: carina fly scan/ --to RB9 -o flight.mp4 --speed 15

    Example: carina fly NAME.carina --keys all -o flight.mp4

    Example: carina fly scan/ --to RB9 -o flight.mp4 --cluster 10.0.0.5 --keep flight-frames/
    """
    with exit_codes(as_json):
        from carina.cli.fly import report

        raise SystemExit(
            report(
                path,
                output=output,
                tree=tree,
                to=to,
                recording=recording,
                keys=keys,
                size=parse_size(size),
                rate_hz=rate,
                speed_mm_s=speed,
                pause_s=pause,
                scope=scope,
                step_vox=step_vox,
                series=series,
                strict=strict,
                ct=ct,
                as_json=as_json,
                cluster=cluster,
                token=token_file,
                mixed=mixed,
                keep=keep,
                captions=captions,
                breathing=breathing,
                cough_s=cough,
            )
        )


app.command()(score)
app.command()(course)
app.command()(insert)


@app.command()
def devices(
    device: Annotated[
        list[str] | None,
        typer.Option(
            help="Device address, such as fastrak:PORT; `carina devices` lists all kinds. May be given several times."
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long to listen, in seconds.")] = 3.0,
    as_json: JsonOption = False,
) -> None:
    """List the input devices of this machine and the data they send.

    Exits with code 4 if a named device sends nothing.

    Example: carina devices --device fastrak:/dev/ttyUSB0 --seconds 10
    """
    with exit_codes(as_json):
        from carina.cli.devices import report

        raise SystemExit(report(device or [], seconds=seconds, as_json=as_json))


app.add_typer(case, name="case")
app.add_typer(pacs, name="pacs")
app.add_typer(cluster, name="cluster")


# The package of benchmarks parses all arguments after ``bench``, also ``--help``.
@app.command(
    "bench",
    add_help_option=False,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def bench(context: typer.Context) -> None:
    """Benchmark Carina against other installed software in the same run. Needs a checkout of the source code."""
    from carina.cli.bench import run_benchmarks

    run_benchmarks(context.args)


USAGE_ERROR: Any = typer.BadParameter.__base__
"""Base class of the errors that typer raises: unknown options, missing arguments, values of the wrong type."""


def main() -> None:
    """Entry point of the ``carina`` command."""
    as_json = "--json" in sys.argv[1:]
    accept_any_text()
    with exit_codes(as_json):
        from carina.config import load_settings

        log_to_terminal(load_settings().log_level)
        try:
            with without_bars():
                code = app(prog_name="carina", standalone_mode=False)
        except USAGE_ERROR as error:
            print_usage_error(error)
            refused = UsageError(error.format_message())
            end_with_error(as_json, refused.code, str(refused), refused.exit_code)
    raise SystemExit(code if isinstance(code, int) else 0)
