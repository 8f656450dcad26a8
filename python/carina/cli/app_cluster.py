"""The commands below ``carina cluster``."""

from __future__ import annotations

from typing import Annotated

import typer

from carina.cli.arguments import check_needs
from carina.cli.console import exit_codes
from carina.cli.options import JsonOption, TokenOption
from carina.errors import UsageError

cluster = typer.Typer(
    help="Render each image on several machines (docs/cluster.md). Needs Linux and Ray (see carina doctor).",
    no_args_is_help=True,
    rich_markup_mode=None,
)

IpOption = Annotated[
    str | None, typer.Option("--ip", help="This machine's address on the private network, if it has several addresses.")
]
DedicatedOption = Annotated[
    bool, typer.Option("--dedicated", help="Render at full priority, on a machine used for nothing else.")
]


@cluster.command("start")
def cluster_start(
    head: Annotated[
        bool,
        typer.Option("--head", help="Start the head node (the first machine), ideally on the machine you work on."),
    ] = False,
    port: Annotated[int, typer.Option(help="Port of the head node.", min=1024, max=65535)] = 6379,
    ip: IpOption = None,
    renders: Annotated[bool, typer.Option("--renders/--no-renders", help="Also render on this machine.")] = True,
    dedicated: DedicatedOption = False,
    token_file: TokenOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a cluster on this machine, print the commands for the other machines, and run until Ctrl-C.

    Example: carina cluster start --head --ip 10.0.0.5
    """
    with exit_codes(as_json):
        if not head:
            raise UsageError(
                "a cluster starts with its head node: carina cluster start --head; other machines then join it"
            )
        if not renders:
            check_needs("machines that render", dedicated=dedicated)
        from carina.cli.cluster import start

        raise SystemExit(
            start(ip=ip, port=port, renders=renders, dedicated=dedicated, token=token_file, as_json=as_json)
        )


AddressArgument = Annotated[str, typer.Argument(help="HOST or HOST:PORT of the head node.", show_default=False)]


@cluster.command("join")
def cluster_join(
    address: AddressArgument,
    ip: IpOption = None,
    dedicated: DedicatedOption = False,
    token_file: TokenOption = None,
    as_json: JsonOption = False,
) -> None:
    """Render for a cluster until Ctrl-C, reconnecting automatically if the connection is lost.

    Example: carina cluster join 10.0.0.5:6379 --token-file ~/cluster.token
    """
    with exit_codes(as_json):
        from carina.cli.cluster import join

        raise SystemExit(join(address, ip=ip, dedicated=dedicated, token=token_file, as_json=as_json))


@cluster.command("status")
def cluster_status(
    address: Annotated[
        str | None, typer.Argument(help="HOST or HOST:PORT of the head node (default: this machine).")
    ] = None,
    token_file: TokenOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the machines in a cluster.

    Example: carina cluster status 10.0.0.5
    """
    with exit_codes(as_json):
        from carina.cli.cluster import status

        raise SystemExit(status(address, token=token_file, as_json=as_json))
