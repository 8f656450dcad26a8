"""Contact sheet of the forks of the chosen route as PNG, created by a job that windows display and can stop."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future

from starlette.responses import Response

from carina.commands import PictureFacts
from carina.errors import CancelledError, CarinaError, NoResultError
from carina.server.files.job_results import set_failure, set_result
from carina.session import Session
from carina.session.flights.fork_sheet import check_forks, fork_sheet_png
from carina.session.jobs.background_jobs import Job
from carina.session.scene.picture_state import PictureState

FILE_NAME = "forks.png"
"""Name of the file, which contains neither the patient nor the case."""


async def fork_sheet_answer(session: Session) -> Response:
    """Return a response with the contact sheet of the chosen route.

    Raises
    ------
    CarinaError
        If there is no route, the route passes no fork or was not searched in the airways, or the job was stopped.
    """
    state: PictureState = session.ask(PictureFacts())
    volume, airways, route, operator = state.volume, state.airways, state.route, state.operator
    if route is None or airways is None:
        raise NoResultError("there is no route yet: choose a branch or mark a target", code="session.route")
    check_forks(route, state.cost)
    done: Future[bytes] = Future()

    def work(job: Job) -> None:
        try:
            png = fork_sheet_png(
                volume, airways, route, cost=state.cost, operator=operator, progress=job.progress, cancel=job.cancel
            )
        except CancelledError:
            set_failure(done, _cancelled(job))
            raise
        except BaseException as error:
            set_failure(done, error if isinstance(error, CarinaError) else _fault())
            raise
        set_result(done, png)

    session.jobs.start("fork-sheet", "rendering the forks", work)
    png = await asyncio.wrap_future(done)
    headers = {"cache-control": "no-store", "content-disposition": f'attachment; filename="{FILE_NAME}"'}
    return Response(png, media_type="image/png", headers=headers)


def _cancelled(job: Job) -> CarinaError:
    if job.stop_reason is None:
        return CarinaError("the contact sheet was cancelled", code="plan.sheet-stopped")
    return CarinaError(f"the contact sheet was cancelled because {job.stop_reason}", code="plan.sheet-lost")


def _fault() -> CarinaError:
    return CarinaError("the contact sheet could not be rendered: internal error in Carina", code="carina.fault")
