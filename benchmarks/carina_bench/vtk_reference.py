"""VTK's CPU ray cast mapper and reslice filter, applied to Carina's scene for comparison."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.render import TransferFunction
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.compared_scene import FOV_DEG

__all__ = ["VtkCaster", "vtk_reslice"]


def _modules() -> tuple[Any, Any]:
    vtk, support = importlib.import_module("vtk"), importlib.import_module("vtkmodules.util.numpy_support")
    # Both thread pools of VTK get one thread.
    vtk.vtkMultiThreader.SetGlobalMaximumNumberOfThreads(1)
    vtk.vtkSMPTools.SetBackend("Sequential")
    vtk.vtkSMPTools.Initialize(1)
    return vtk, support


def _grid_frame(volume: Volume) -> tuple[NDArray[np.int16], NDArray[np.float64]]:
    """Return the values of a volume on a right-handed grid, and the matrix ``lps_from_grid``.

    VTK's box stays parallel to the axes, so the camera is moved instead.
    """
    values, matrix = volume.hu_zyx, volume.lps_from_ijk.copy()
    if np.linalg.det(matrix[:3, :3]) < 0:
        # A mirrored grid would need a mirrored camera, so the order of its slices is reversed instead.
        values = np.ascontiguousarray(values[::-1])
        matrix[:3, 3] += matrix[:3, 2] * (volume.shape_zyx[0] - 1)
        matrix[:3, 2] *= -1
    matrix[:3, :3] /= np.array(volume.spacing_mm)
    return values, matrix


class VtkCaster:
    """Renderer that uses ``vtkFixedPointVolumeRayCastMapper``: one thread, every pixel, shading on.

    ``cast`` only casts the rays; ``cast_and_show`` also draws the picture in a window, which VTK does by OpenGL. The
    constructor renders a first picture, which computes the gradients of all voxels, so that they are not measured
    later.
    """

    def __init__(
        self,
        volume: Volume,
        transfer: TransferFunction,
        *,
        step_vox: float,
        size: int,
        shading: bool = True,
        unsigned: bool = False,
    ) -> None:
        vtk, support = _modules()
        self._vtk, self._support = vtk, support
        values, lps_from_grid = _grid_frame(volume)
        self._grid_from_lps = np.linalg.inv(lps_from_grid)
        nz, ny, nx = volume.shape_zyx
        image = vtk.vtkImageData()
        image.SetDimensions(nx, ny, nz)
        image.SetSpacing(*volume.spacing_mm)
        # CT values are int16; shifted to uint16 they save the mapper a multiplication per sample.
        offset = int(values.min()) if unsigned else 0
        kind = vtk.VTK_UNSIGNED_SHORT if unsigned else vtk.VTK_SHORT
        moved = np.subtract(values, offset, dtype=np.int32).astype(np.uint16) if unsigned else values
        scalars = support.numpy_to_vtk(moved.ravel(), deep=False, array_type=kind)
        image.GetPointData().SetScalars(scalars)
        colour, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        for hu, red, green, blue, alpha in transfer.points:
            colour.AddRGBPoint(hu - offset, red, green, blue)
            opacity.AddPoint(hu - offset, alpha)
        properties = vtk.vtkVolumeProperty()
        properties.SetColor(colour)
        properties.SetScalarOpacity(opacity)
        properties.SetScalarOpacityUnitDistance(transfer.reference_mm)
        properties.SetInterpolationTypeToLinear()
        if shading:
            properties.ShadeOn()
            properties.SetAmbient(transfer.light.ambient)
            properties.SetDiffuse(transfer.light.diffuse)
            properties.SetSpecular(transfer.light.specular)
            properties.SetSpecularPower(2.0**transfer.light.shininess_log2)
        else:
            properties.ShadeOff()
        mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        mapper.SetInputData(image)
        mapper.SetAutoAdjustSampleDistances(0)
        mapper.SetImageSampleDistance(1.0)
        step_mm = step_vox * float(min(volume.spacing_mm))
        mapper.SetSampleDistance(step_mm)
        mapper.SetInteractiveSampleDistance(step_mm)
        mapper.SetNumberOfThreads(1)
        self._actor = vtk.vtkVolume()
        self._actor.SetMapper(mapper)
        self._actor.SetProperty(properties)
        self._mapper = mapper
        self._renderer = vtk.vtkRenderer()
        self._renderer.SetBackground(0, 0, 0)
        self._renderer.AddVolume(self._actor)
        self._window = vtk.vtkRenderWindow()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._window.SetSize(size, size)
        self._window.AddRenderer(self._renderer)
        # VTK reads this memory without owning it, so this object must hold a reference.
        self._keep = (image, moved, scalars)

    def look(self, pose: Pose) -> None:
        """Set the camera and render one picture that is not measured, so that the next one is not the first."""
        grid_from_camera = self._grid_from_lps @ pose.lps_from_camera
        position, forward, down = (grid_from_camera[:3, column] for column in (3, 2, 1))
        camera = self._renderer.GetActiveCamera()
        camera.SetPosition(*position)
        camera.SetFocalPoint(*(position + forward))
        camera.SetViewUp(*(-down))
        camera.SetViewAngle(FOV_DEG)
        camera.SetClippingRange(0.01, 2000.0)
        self._window.Render()

    def cast(self) -> None:
        """Cast one picture without drawing it in a window."""
        nothing, box = [0.0, 0.0, 0.0], [0, 0, 0, 0, 0, 0]
        self._mapper.PerImageInitialization(self._renderer, self._actor, 0, nothing, nothing, box)
        self._mapper.PerVolumeInitialization(self._renderer, self._actor)
        self._mapper.PerSubVolumeInitialization(self._renderer, self._actor, 0)
        self._mapper.RenderSubVolume()

    def cast_and_show(self) -> None:
        """Cast one picture and draw it in an offscreen window."""
        self._window.Render()

    def picture(self) -> NDArray[np.uint8]:
        """Return the picture in the window, (size, size, 3) uint8."""
        grab = self._vtk.vtkWindowToImageFilter()
        grab.SetInput(self._window)
        grab.ReadFrontBufferOff()
        grab.SetInputBufferTypeToRGB()
        self._window.Render()
        grab.Update()
        shown = grab.GetOutput()
        width, height, _ = shown.GetDimensions()
        rgb = self._support.vtk_to_numpy(shown.GetPointData().GetScalars()).reshape(height, width, 3)
        return np.ascontiguousarray(rgb[::-1])

    def close(self) -> None:
        """Release the memory that VTK holds."""
        self._window.Finalize()
        self._renderer.RemoveVolume(self._actor)


def vtk_reslice(
    volume: Volume, lps_from_pixel: NDArray[np.float64], width: int, height: int
) -> Callable[[], NDArray[np.int16]]:
    """Return a function that samples a plane of a volume with ``vtkImageReslice``: linear, one thread.

    The function returns values (height, width) int16.
    """
    vtk, support = _modules()
    values, lps_from_grid = _grid_frame(volume)
    nz, ny, nx = volume.shape_zyx
    image = vtk.vtkImageData()
    image.SetDimensions(nx, ny, nz)
    image.SetSpacing(*volume.spacing_mm)
    scalars = support.numpy_to_vtk(values.ravel(), deep=False, array_type=vtk.VTK_SHORT)
    image.GetPointData().SetScalars(scalars)
    plane = np.linalg.inv(lps_from_grid) @ lps_from_pixel
    steps = np.linalg.norm(plane[:3, :2], axis=0)
    normal = np.cross(plane[:3, 0] / steps[0], plane[:3, 1] / steps[1])
    matrix = vtk.vtkMatrix4x4()
    columns = (plane[:3, 0] / steps[0], plane[:3, 1] / steps[1], normal, plane[:3, 3])
    for column, vector in enumerate(columns):
        for row in range(3):
            matrix.SetElement(row, column, float(vector[row]))
    reslice = vtk.vtkImageReslice()
    reslice.SetInputData(image)
    reslice.SetResliceAxes(matrix)
    reslice.SetOutputDimensionality(2)
    reslice.SetInterpolationModeToLinear()
    reslice.SetBackgroundLevel(-1000)
    reslice.SetOutputSpacing(float(steps[0]), float(steps[1]), 1.0)
    # ``lps_from_pixel`` maps pixel corners, VTK samples at pixel centres.
    reslice.SetOutputOrigin(0.5 * float(steps[0]), 0.5 * float(steps[1]), 0.0)
    reslice.SetOutputExtent(0, width - 1, 0, height - 1, 0, 0)
    reslice.SetNumberOfThreads(1)
    keep = (image, values, scalars)

    def sample() -> NDArray[np.int16]:
        assert keep
        reslice.Modified()
        reslice.Update()
        out = support.vtk_to_numpy(reslice.GetOutput().GetPointData().GetScalars())
        return np.asarray(out, dtype=np.int16).reshape(height, width)

    return sample
