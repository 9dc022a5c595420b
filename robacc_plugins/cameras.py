"""Cameras: the rays of pixels, the pose of a board from its points in one photo, and what the rows of a file show.

A camera file (YAML) has ``fx``, ``fy``, ``cx``, ``cy`` (px), ``distortion`` (``[k1, k2, p1, p2, k3]``, zero by
default), ``size`` (px) and ``mount``: ``world`` for a camera beside the arm, ``hand`` for one that the arm moves. With
the mount only, the photos are to show the lens. For several cameras, ``cameras`` has these keys under each name.
"""

import math
import os
import statistics
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import yaml

from robacc.errors import Note, listing, refuse
from robacc.geometry import Array, NDArray, Poses, compose, exp_so3, nearest_rotation, skew
from robacc.io.files import read_text
from robacc.io.yaml_nodes import YamlSection, join, top_section
from robacc.measurements import IMAGES, Measurements, numbered, numbered_visits
from robacc.plug_ins import plug_in
from robacc.poses.cameras import BOARDS, projection
from robacc.poses.csv_file import KindTable
from robacc.poses.reading import heading_of

_PIXELS = ("u_px", "v_px")
_BOARD = ("board_x", "board_y", "board_z")
"""Columns of an image: the pixel, and the point of the board."""
_KEYS = ("fx", "fy", "cx", "cy", "distortion", "size", "mount")
_MOST = 1e6
"""px: no lens is longer, and no picture wider."""
_STEPS = 100
"""Steps at most; distortion of usual lenses takes ten, the pose of a board five."""
_SETTLED = 1e-12
FEWEST_POINTS = 4
"""Points of a plane that a photo must show for the pose of the board."""
_FAR_OFF = 1.0
"""px; points that are found well lie a tenth to a third of it off the board that the lens shows."""


class Camera(NamedTuple):
    """Pinhole camera with the distortion of D. C. Brown (1971), as OpenCV numbers it."""

    focal: tuple[float, float]
    """Focal lengths along x and y, px; zero where the file states the mount only."""
    centre: tuple[float, float]
    """Principal point, px."""
    distortion: tuple[float, ...] = (0.0,) * 5
    """k1, k2, p1, p2, k3."""
    size: tuple[float, ...] | None = None
    """Width and height, px."""
    is_on_hand: bool = False
    """The arm moves the camera; otherwise it stands beside the arm, and the arm moves the board."""

    def rays(self, pixels: Array) -> Array:
        """Return the directions x/z, y/z ``(2, N)`` of pixels ``(2, N)``; NaN where the distortion has no inverse."""
        seen = ((pixels.T - self.centre) / self.focal).T
        ray = seen
        for _ in range(_STEPS):
            before = ray
            radius, shift = self._distortion(ray)
            with np.errstate(all="ignore"):
                ray = (seen - shift) / radius
            if np.max(np.abs(ray - before), initial=0.0) < _SETTLED:
                break
        radius, shift = self._distortion(ray)
        return np.where(np.abs(radius * ray + shift - seen).max(axis=0) < _SETTLED**0.5, ray, np.nan)

    def _distortion(self, ray: Array) -> tuple[Array, Array]:
        """Return the factor ``(N,)`` and the shift ``(2, N)`` by which the lens moves rays."""
        k1, k2, p1, p2, k3 = self.distortion
        # Tangent of the angle to the axis of a camera: that of no lens is near 100.
        ray = np.where(np.abs(ray) < 100.0, ray, np.nan)
        (x, y), square = ray, np.sum(np.square(ray), axis=0)
        shift = np.stack((2 * p1 * x * y + p2 * (square + 2 * x * x), p1 * (square + 2 * y * y) + 2 * p2 * x * y))
        return 1 + square * (k1 + square * (k2 + square * k3)), shift


def read_cameras(path: str | os.PathLike[str]) -> dict[str, Camera]:
    """Return the cameras of a file by their names; the only one has the name ``""``.

    Raises:
        InputError: The file cannot be read or is wrong; with every problem.
    """
    name = os.fspath(path)
    top = top_section(read_text(name), name, (*_KEYS, "cameras"))
    sections = {"": top}
    several = top.get("cameras")
    for key in (key for key in _KEYS if several is not None and top.get(key) is not None):
        top.report(key, "stands beside cameras", "write it under the name of each")
    if several is not None:
        entries = top.source.entries(several, "cameras") if isinstance(several, yaml.MappingNode) else ()
        if not isinstance(several, yaml.MappingNode):
            top.report("cameras", "expected names with the keys of each camera")
        parts = {key: top.source.section(node, join("cameras", key), _KEYS) for key, _, node in entries}
        sections = {key: part for key, part in parts.items() if part is not None}
    cameras = {key: _camera(section) for key, section in sections.items()}
    top.source.raise_if_any()
    return cameras


def calibrated(camera: Camera, pixels: Array, points: Array, photo: NDArray[Any]) -> Camera:
    """Return a camera whose file states its mount only with the lens that shows a flat board best (Z. Zhang 2000).

    ``pixels`` ``(2, N)`` are images of ``points`` ``(3, N)`` of each ``photo`` ``(N,)``.

    Raises:
        UsageError: The extra ``camera`` is not installed.
        ValueError: The photos do not show the lens.
    """
    if camera.focal[0] > 0.0:
        return camera
    photos = [rows for rows in _rows_of_each(photo) if rows.size >= FEWEST_POINTS]
    size = camera.size or tuple(np.ceil(pixels.max(axis=1) + pixels.min(axis=1)).tolist())
    boards, images = ([part[:, rows].T for rows in photos] for part in (points, pixels))
    focal, centre, distortion = plug_in(BOARDS, "lens")(boards, images, size)
    return camera._replace(focal=focal, centre=centre, distortion=distortion)


def _camera(section: YamlSection) -> Camera:
    is_known = any(section.get(key) is not None for key in _KEYS[:5])
    fx, fy, cx, cy = (
        section.number(key, lambda value: 0 < value < _MOST, f"pixels, above 0 and below {_MOST:g}")
        if is_known
        else 0.0
        for key in _KEYS[:4]
    )
    distortion, size = (
        None if (node := section.get(key)) is None else section.source.numbers(node, section.at(key), count)
        for key, count in (("distortion", 5), ("size", 2))
    )
    mount = section.text("mount", ("hand", "world"), needed=True)
    if size is not None and min(size) <= 0:
        section.report("size", "expected a width and a height above 0 px")
    return Camera((fx, fy), (cx, cy), distortion or (0.0,) * 5, size, mount == "hand")


# Pose of a board from its points: a homography of their plane, improved to the least squares of the rays.


class Photo(NamedTuple):
    """Pose of a board in the camera, as one photo shows it."""

    rows: NDArray[np.int64]
    """``(K,)`` its points, without those far off."""
    pose: Poses
    covariance: Array
    """``(6, 6)`` of the shift and the turn of the pose in the axes of the camera, for rays of unit noise."""
    squares: float
    """Sum of squares of the remaining errors of the rays."""

    def of_camera(self) -> "Photo":
        """Return the pose of the camera in the board: it stands at -R' t, which a turn of the board moves too."""
        back = self.pose.rotation.T
        moves = np.block([[-back, -back @ skew(self.pose.translation)], [np.zeros((3, 3)), -back]])
        return self._replace(
            pose=Poses(back, -back @ self.pose.translation), covariance=np.asarray(moves @ self.covariance @ moves.T)
        )


def _rows_of_each(photo: NDArray[Any]) -> list[NDArray[np.int64]]:
    """Return the rows of each photo, in their order."""
    which = np.unique(photo, return_inverse=True)[1]
    return np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])


def photos_of(rays: Array, points: Array, photo: NDArray[Any]) -> tuple[list[Photo], float]:
    """Return the photos that show the pose of the board, and the RMS of what remains of their rays.

    Args:
        rays: ``(2, N)`` directions x/z, y/z without distortion.
        points: ``(3, N)`` points in the frame of the board, those of a photo near a plane, m.
        photo: ``(N,)`` the photo of each.

    Raises:
        ValueError: No photo shows the pose of the board.
    """
    found = []
    for rows in _rows_of_each(photo):
        each = _fitted(rays, points, rows)
        if each is not None:
            errors = np.linalg.norm(rays[:, rows] - rays_of(each.pose, points[:, rows]), axis=0)
            # Six median errors off, a point is no image of its board, as a wrong corner is.
            near = rows[errors <= max(6.0 * float(np.median(errors)), _SETTLED)]
            each = each if near.size == rows.size else _fitted(rays, points, near)
        if each is not None:
            found.append(each)
    refuse((not found, f"no photo shows {FEWEST_POINTS} points of a board that are not in a line"), error=ValueError)
    spare = sum(2 * each.rows.size - 6 for each in found)
    return found, float(np.sqrt(sum(each.squares for each in found) / max(spare, 1)))


def three_points(points: Array) -> Array:
    """Return three points ``(3, 3)`` that show a board's pose nearly as its points ``(3, K)`` do, each K/3 times.

    They have the same mean and the same spread in the plane of the board (sigma points; Julier and Uhlmann 1997), on
    which shifts, the distance and the turn in the plane depend. A tilt depends on higher moments too, so that its
    variance is off by up to a third.
    """
    centre = points.mean(axis=1, keepdims=True)
    axes, spread, _ = np.linalg.svd((points - centre) / np.sqrt(points.shape[1]), full_matrices=False)
    angle = 2.0 * np.pi / 3.0 * np.arange(3)
    return np.asarray(centre + np.sqrt(2.0) * (axes[:, :2] * spread[:2]) @ np.stack((np.cos(angle), np.sin(angle))))


def rays_of(pose: Poses, points: Array) -> Array:
    """Return the rays ``(2, K)`` of points ``(3, K)`` of a board at a pose in the camera."""
    at = pose.rotation @ points + pose.translation[:, None]
    return np.asarray(at[:2] / at[2])


def _fitted(rays: Array, points: Array, rows: NDArray[np.int64]) -> Photo | None:
    """Return the pose of a board by Gauss-Newton from its homography; None if the points do not show it."""
    if rows.size < FEWEST_POINTS:
        return None
    rays, points = rays[:, rows], points[:, rows]
    pose = _start(rays, points)
    for _ in range(_STEPS):
        lever = pose.rotation @ points
        at = lever + pose.translation[:, None]
        if not np.all(at[2] > 0.0):
            return None
        ahead = projection(at)
        moved = np.concatenate((ahead, -compose(ahead, skew(lever))), axis=1)
        jacobian, error = moved.transpose(2, 0, 1).reshape(2 * rows.size, 6), (rays - at[:2] / at[2]).T.ravel()
        if np.linalg.matrix_rank(jacobian) < 6:
            return None
        step = np.linalg.lstsq(jacobian, error, rcond=None)[0]
        if np.max(np.abs(step)) < _SETTLED:
            return Photo(rows, pose, np.asarray(np.linalg.inv(jacobian.T @ jacobian)), float(error @ error))
        pose = Poses(exp_so3(step[3:]) @ pose.rotation, pose.translation + step[:3])
    return None


def _start(rays: Array, points: Array) -> Poses:
    """Return the pose of a board from the homography of its plane (Z. Zhang 2000, section 3.1)."""
    centre = points.mean(axis=1)
    axes = np.linalg.svd(points - centre[:, None])[0]
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    scale = np.sqrt(np.mean(np.square(points - centre[:, None]))) or 1.0
    plane = np.concatenate(((axes[:, :2].T @ (points - centre[:, None])) / scale, np.ones((1, points.shape[1]))))
    rows = [np.kron((0.0, -1.0, y), each) for (_, y), each in zip(rays.T, plane.T, strict=True)]
    rows += [np.kron((1.0, 0.0, -x), each) for (x, _), each in zip(rays.T, plane.T, strict=True)]
    first, second, origin = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3).T
    size = (np.linalg.norm(first) + np.linalg.norm(second)) / 2 * np.copysign(1.0, origin[2])
    first, second, origin = first / size, second / size, origin * scale / size
    rotation = nearest_rotation(np.column_stack((first, second, np.cross(first, second)))) @ axes.T
    return Poses(rotation, origin - rotation @ centre)


# What the rows of kind image of a file show.


class ImageRows(NamedTuple):
    """Points of a board in photos, as the rows of kind image of a file give them."""

    rows: NDArray[np.bool_]
    """``(N,)`` rows of this kind."""
    cameras: Mapping[str, Any]
    """Cameras by their names, as the plug-in read them."""
    file: str
    """File of the cameras."""
    names: NDArray[np.str_]
    """``(N,)`` camera of each row."""
    pixels: Array
    """``(2, N)`` px."""
    points: Array
    """``(3, N)`` points in the frame of the board, m."""
    noise: Array | None
    """``(N,)`` standard deviation of a pixel, px; None if it is not stated."""
    sizes: Mapping[str, tuple[int, ...]]
    """Width and height, px, of the photos of each camera."""


def _images(data: Measurements, table: KindTable) -> ImageRows:
    """Return what the rows of kind image show, and the cameras that took them.

    Raises:
        InputError: A column or the file of the cameras is missing, or a value is wrong; with every problem.
    """
    log, cells = table.log, table.cells
    if table.cameras is None:
        log.add("images need the camera that took them", table.line, fix="give its file as `camera`")
    for key in (key for key in (*_PIXELS, *_BOARD[:2]) if key not in cells):
        log.add(f"images need the column {key}, which is missing", table.line)
    if "sigma" in cells and heading_of(table.headings["sigma"]).unit is not None:
        log.add("the sigma of images is in px", table.line, table.headings["sigma"], "name the column sigma")
    log.raise_if_any()
    rows, names = np.isin(np.array(data.kind), "image"), table.column_of("camera")
    cameras = read_cameras(table.cameras or "")
    pixels = np.stack([table.numbers(key, rows, data) for key in _PIXELS])
    points = np.stack([table.numbers(key, rows, data, 0.0 if key == "board_z" else None) for key in _BOARD])
    # px; no corner is found as well.
    noise = table.numbers("sigma", rows, data, least=1e-3, unit="px") if "sigma" in cells else None
    log.raise_if_any()
    return ImageRows(rows, cameras, table.cameras or "", np.array(names), pixels, points, noise, table.image_sizes)


def with_images(data: Measurements, table: KindTable) -> Measurements:
    """Return the data with the poses that photos show in their rows, and with the photos as visits.

    Args:
        data: Rows of all kinds.
        table: Their table, whose log takes problems, warnings and notes.

    Raises:
        InputError: As :func:`_images`.
    """
    assert data.kind is not None
    assert data.fixture is not None
    images, log, report = _images(data, table), table.log, partial(table.report, data)
    rows, cameras, names, noise = images.rows, images.cameras, images.names, images.noise
    pixels, points = images.pixels, images.points
    values = np.vstack((pixels, points, *([] if data.q is None else [data.q])))
    first = np.zeros(data.n, dtype=bool)
    first[np.unique(values, axis=1, return_index=True)[1]] = True
    if copied := int(np.count_nonzero(rows & ~first)):
        log.warn(f"{copied} points repeat pixel and joints of earlier rows and are left out", of_file=True)
    stay, rows = ~rows, rows & first
    photo = data.visit
    if photo is None:
        poses = data.groups() if data.cycle is None else numbered(data.groups(), data.cycle)
        photo = numbered_visits(poses, None, None, numbered(names, *points), ordered=False).astype(str)
    seen, place, spread = (np.zeros((count, data.n)) for count in (5, 3, 6))
    turn, position = np.zeros((3, 3, data.n)), data.position.copy()
    sigma = np.zeros((3, data.n)) if data.sigma_position is None else data.sigma_position.copy()
    kind, fixture = data.kind.astype(object), data.fixture.astype(object)
    for name in np.unique(names[rows]).tolist():
        mine = np.flatnonzero(rows & (names == name))
        only = next(iter(cameras.values())) if len(cameras) == 1 and name == "" else cameras.get("")
        if (camera := cameras.get(name, only)) is None:
            expected = f"expected a camera of {images.file}: {', '.join(cameras)}"
            report(f"found {name!r}, {expected}", int(mine[0]), "camera")
            continue
        of_board, size = (points[:, mine], photo[mine]), images.sizes.get(name)
        if size and camera.size and camera.size != size:
            sizes = [f"{width:g} x {height:g} px" for width, height in (size, camera.size)]
            fix, scale = "give the lens as photos of this size show it", size[0] / camera.size[0]
            if size[1] == scale * camera.size[1]:
                fix += f", or multiply fx, fy, cx, cy and size by {scale:.6g}"
            log.add(f"the photos are {sizes[0]}, the camera file states {sizes[1]}", fix=fix)
            continue
        try:
            camera = calibrated(camera, pixels[:, mine], *of_board)
            rays = camera.rays(pixels[:, mine])
            for row in mine[np.isnan(rays).any(axis=0)].tolist():
                report("the lens of the camera cannot show anything at this pixel", row, "u_px")
            log.raise_if_any()
            photos, rest = photos_of(rays, *of_board)
        except ValueError as error:
            report(str(error), int(mine[0]), fix="check u_px, v_px, board_x, board_y and the camera")
            continue
        depth = statistics.median(float(each.pose.translation[2]) for each in photos)
        focal, used = float(np.mean(camera.focal)), sum(each.rows.size for each in photos)
        for each in photos:
            # Three points stand for the photo: their six numbers are its pose.
            of_photo = mine[each.rows]
            three, corners = of_photo[:3], three_points(points[:, of_photo])
            std = rest if noise is None else math.sqrt(np.mean(np.square(noise[of_photo]))) / focal
            shown = each.of_camera() if camera.is_on_hand else each
            stay[three], seen[:3, three], seen[3:, three] = True, corners, [[depth], [focal]]
            position[:2, three] = depth * rays_of(each.pose, corners)
            sigma[:, three] = depth * std * math.sqrt(3.0 / of_photo.size)
            place[:, three], turn[..., three] = shown.pose.translation[:, None], shown.pose.rotation[..., None]
            spread[:, three] = std * np.sqrt(np.diag(shown.covariance))[:, None]
        kind[mine], fixture[mine] = IMAGES[camera.is_on_hand], "board" if camera.is_on_hand else name or "camera"
        taken, lost = np.unique(photo[mine]), {*photo[mine]} - {photo[mine[each.rows[0]]] for each in photos}
        begins = [data.place(int(mine[photo[mine] == name][0])) for name in sorted(lost)]
        lens = ", ".join(f"{value:.5g}" for value in (*camera.focal, *camera.centre))
        text = (
            f"{f'camera {name}: ' if name else ''}{used} of {mine.size} points in {len(photos)} of {taken.size} "
            "photos are "
            f"{rest * focal:.2g} px (rms) off the board, with fx, fy, cx, cy of {lens}"
            f"{'; photos that do not show the board begin at ' * bool(lost)}{listing(begins)}"
        )
        if rest * focal > _FAR_OFF:
            text += "; usual is a third of a pixel or less: check the lens, its size, and the sizes of the board"
        log.warn(Note(text) if used == mine.size and rest * focal <= _FAR_OFF else text, of_file=True)
    if data.direction is not None and data.speed is not None:  # The points of a photo were reached by one motion.
        _, begin, which = np.unique(photo, return_index=True, return_inverse=True)
        begin = np.where(rows, begin[which], np.arange(data.n))
        data = replace(data, direction=data.direction[:, begin], speed=data.speed[:, begin])
    if len(cameras) > 1 and data.target is None and IMAGES[True] in kind:
        data = replace(data, target=np.where(kind == IMAGES[True], names, np.where(rows, "board", "")))
    return replace(
        data,
        kind=kind.astype(str),
        fixture=fixture.astype(str),
        position=position,
        sigma_position=sigma,
        visit=photo,
        seen=seen,
        photos=Measurements(
            place,
            turn,
            sigma_position=spread[:3],
            sigma_rotation=np.sqrt(np.square(spread[3:]).mean(axis=0)),
        ),
    ).subset(stay)
