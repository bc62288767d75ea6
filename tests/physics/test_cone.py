# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
from pydrake.solvers import MathematicalProgram, MobyLcpSolver

from pinwm_drake.geometry.shapes import box
from pinwm_drake.physics.cone import solve
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.reference import build_problem
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.scenes import box_inertia, nominal, push_model, push_start, random_quaternion, straight_push


def random_worlds(model, num_worlds, seed):
    """Blocks in random orientation that dip into the floor or hang just above it, with random velocities."""
    generator = torch.Generator().manual_seed(seed)
    q = random_quaternion(generator, num_worlds, 1)
    # Half of them lie flat, so that whole faces are in contact.
    flat = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    q[::2] = flat
    z = torch.where(torch.arange(num_worlds) % 2 == 0, 0.025, 0.05).to(torch.float64)
    p = torch.zeros(num_worlds, 1, 3, dtype=torch.float64)
    p[:, 0, 2] = z + 0.002 * torch.randn(num_worlds, dtype=torch.float64, generator=generator)
    V = torch.randn(num_worlds, 1, 6, dtype=torch.float64, generator=generator)
    V = V * torch.tensor([2.0] * 3 + [0.4] * 3)
    state = State.at_rest(model, num_worlds, p_WP=(0.02, -0.0645, 0.02))
    return State(q, p, V, state.q_WP, state.p_WP)


@pytest.fixture(scope="module")
def problem():
    model = push_model()
    parameters = nominal(model, friction_floor=0.5, friction_pusher=0.3, num_worlds=120)
    return model, parameters, random_worlds(model, 120, seed=7), straight_push(1, 120)[0]


def test_residuals_signs_and_complementarity_hold_to_1e_9(problem):
    model, parameters, state, V_WP = problem
    touched = 0
    for world in range(state.num_worlds):
        report = inspect(model, parameters, state, V_WP, world=world)
        touched += int((report.impulse[:, 0] > 0.0).any())
        assert report.momentum_residual <= 1e-9
        assert report.sign_violation <= 1e-9
        assert report.complementarity <= 1e-9
    assert touched >= 80  # the scenes really are in contact


def test_a_push_stays_solved_to_1e_9():
    model = push_model()
    parameters, state = nominal(model, friction_floor=0.03, friction_pusher=0.03), push_start(model)
    stepper, V = Stepper(model), straight_push(200)
    for t in range(200):
        report = inspect(model, parameters, state, V[t])
        assert max(report.momentum_residual, report.sign_violation, report.complementarity) <= 1e-9
        state = stepper.step(parameters, state, V[t])


def polyhedral_lcp(problem, world, directions):
    """Matrix and vector of the LCP of a world with a polyhedral cone, and how velocities follow from its solution."""
    A, p, J, bias = (value[world].numpy() for value in (problem.A, problem.p, problem.J, problem.bias))
    real = [c for c in range(len(J)) if np.abs(J[c]).max() > 0.0]
    angle = 2.0 * np.pi * np.arange(directions) / directions
    fan = np.column_stack([np.cos(angle), np.sin(angle)])
    C, rows = len(real), directions + 2
    H, B, b = np.zeros((C, rows, A.shape[0])), np.zeros((C, rows, C, rows)), np.zeros((C, rows))
    for i, c in enumerate(real):
        H[i, 0], H[i, 1:-1] = J[c, 0], fan @ J[c, 1:]
        b[i, 0], b[i, 1:-1] = bias[c, 0], fan @ bias[c, 1:]
        own = problem.compliance * np.eye(rows)
        own[-1, -1] = 0.0
        own[1:-1, -1], own[-1, 1:-1], own[-1, 0] = 1.0, -1.0, float(problem.mu[world, c])
        B[i, :, i] = own
    H, B = H.reshape(C * rows, -1), B.reshape(C * rows, C * rows)
    matrix = H @ np.linalg.solve(A, H.T) + B
    vector = H @ np.linalg.solve(A, p) + b.ravel()
    return matrix, vector, lambda z: np.linalg.solve(A, p + H.T @ z)


@pytest.mark.parametrize(
    ("directions", "friction", "tolerance", "most"),
    [(4, 0.0, 1e-6, 30), pytest.param(48, 0.5, 1e-2, 120, marks=pytest.mark.nightly)],
)
def test_drakes_moby_solver_finds_the_same_velocities(problem, directions, friction, tolerance, most):
    # Of a polyhedral cone, which becomes the round one: of 48 directions one is never farther than 4 degrees.
    model, _, state, V_WP = problem
    parameters = nominal(model, friction_floor=friction, friction_pusher=friction, num_worlds=state.num_worlds)
    equations, _, _, _ = build_problem(model, parameters, state, V_WP)
    solved = 0
    for world in range(state.num_worlds):
        if solved == most:
            break
        report = inspect(model, parameters, state, V_WP, world=world)
        if report.parts > 1 or not report.pair:
            continue  # the equations are those of a step with contacts and without an impact
        matrix, vector, velocities = polyhedral_lcp(equations, world, directions)
        program = MathematicalProgram()
        z = program.NewContinuousVariables(len(vector))
        program.AddLinearComplementarityConstraint(matrix, vector, z)
        result = MobyLcpSolver().Solve(program)
        if not result.is_success():
            continue
        z_moby = result.GetSolution(z)
        slack = matrix @ z_moby + vector
        if min(z_moby.min(), slack.min()) < -1e-8 or np.abs(z_moby * slack).max() > 1e-8:
            continue  # Moby's own pivoting lost its way; its answer is no oracle then
        solved += 1
        # Moby accepts residuals of about 1e-8, divided by inertias; of points 5 cm away, m/s.
        difference = (report.u - velocities(z_moby)) * np.array([0.05] * 3 + [1.0] * 3)
        assert np.abs(difference).max() < tolerance
    assert solved >= 30


@pytest.mark.parametrize("heading", np.linspace(0.0, np.pi / 4, 5))
def test_what_slides_comes_to_rest_in_the_same_way_in_every_direction(heading):
    # v^2 / 2 mu g, straight ahead: no direction is another one. A plate so low that it does not tilt.
    size, mu, speed = (0.2, 0.2, 0.001), 0.3, 0.5
    model = Model(bodies=[Body("plate", [box(size)], 0.4, box_inertia(size, 0.4))], time_step=1 / 960)
    v = speed * torch.tensor([math.cos(heading), math.sin(heading)], dtype=torch.float64)
    V = torch.zeros(1, 1, 6, dtype=torch.float64)
    V[0, 0, 3:5] = v
    state = State.at_rest(model, p_WB=(0.0, 0.0, 0.0005), V_WB=V)
    theta = nominal(model, friction_floor=mu)
    end = Stepper(model).rollout(theta, state, torch.zeros(200, 1, 6, dtype=torch.float64)).frame(-1)
    way = end.p_WB[0, 0, :2]
    assert float(end.V_WB.abs().max()) < 1e-6
    assert float(way.norm()) == pytest.approx(speed**2 / (2 * mu * 9.81), rel=1e-2)
    assert float(way @ v) / float(way.norm() * speed) == pytest.approx(1.0, abs=1e-7)


def many_contact_step():
    """A block that slides and spins, out of the pusher's reach: all floor contacts slip in different directions."""
    model = push_model()
    start = push_start(model)
    V = torch.tensor([[[0.0, 0.0, 2.0, 0.05, 0.12, 0.0]]], dtype=torch.float64)
    away = torch.tensor([[0.02, -0.2, 0.02]], dtype=torch.float64)
    state = State(start.q_WB, start.p_WB, V, start.q_WP, away)
    return model, nominal(model, friction_floor=0.4, friction_pusher=0.3), state, straight_push(1)[0]


def test_friction_derivatives_need_the_transposed_system():
    model, parameters, state, V_WP = many_contact_step()
    floor = model.pair_names.index("t_block-floor")
    report = inspect(model, parameters, state, V_WP)
    sliding = (np.linalg.norm(report.slip[:, 1:], axis=1) > 1e-6) & (report.impulse[:, 0] > 0.0)
    assert sliding.sum() >= 6

    # Of the positions, which move with the velocities of the first stage.
    weights = torch.tensor([0.0, 0.0, 0.0, 0.5, -0.7, 0.1], dtype=torch.float64)

    def loss(friction):
        theta = Parameters(parameters.mass, parameters.inertia, friction, parameters.restitution)
        return (Stepper(model).step(theta, state, V_WP).p_WB[0, 0] * weights[3:]).sum() / model.time_step

    friction = parameters.friction.clone().requires_grad_()
    loss(friction).backward()
    ours = float(friction.grad[0, floor])
    step = 1e-6
    delta = torch.zeros_like(parameters.friction)
    delta[0, floor] = step
    difference = float(loss(parameters.friction + delta) - loss(parameters.friction - delta)) / (2 * step)
    assert ours == pytest.approx(difference, rel=1e-6)

    # The same adjoint with the derivative itself in place of its transpose, as in PIN-WM's released code.
    problem, contacts, _, free = build_problem(model, parameters, state, V_WP)
    x, _ = solve(problem, free)
    S = problem.derivative(x)[0]
    v = problem.velocity(x)
    normal = problem.contact_impulse(v)[0, :, 0]
    along = -v[0, :, 1:] / v[0, :, 1:].norm(dim=-1, keepdim=True)
    on_floor = contacts.pair[0] == floor
    force = (problem.J[0, :, 1:] * along[..., None]).sum(1) * normal[:, None]  # the friction's per coefficient
    value = {}
    for name, matrix in (("transposed", S.mT), ("untransposed", S)):
        y = torch.linalg.solve(matrix, weights)
        value[name] = float((force @ y)[on_floor].sum())
    assert value["transposed"] == pytest.approx(difference, rel=1e-6)
    assert abs(value["untransposed"] / difference - 1.0) > 0.1


def test_the_reference_finds_the_law_of_contacts(problem):
    model, parameters, state, V_WP = problem
    equations, _, _, free = build_problem(model, parameters, state, V_WP)
    x, found = solve(equations, free)
    assert found.all()
    impulse = equations.contact_impulse(equations.velocity(x))
    slip = equations.velocity(x) + equations.compliance * impulse
    most = equations.mu * impulse[..., 0]
    assert float((impulse[..., 0] * slip[..., 0]).abs().max()) < 1e-9
    assert float(slip[..., 0].min()) > -1e-9
    assert float((impulse[..., 1:].norm(dim=-1) - most).max()) < 1e-9
    power = (impulse[..., 1:] * slip[..., 1:]).sum(-1) + most * slip[..., 1:].norm(dim=-1)
    assert float(power.abs().max()) < 1e-9


def test_one_step_does_not_depend_on_the_steps_before_it():
    # Cold and warm: what a rollout finds is what a step from its states finds, to the last bit.
    model = push_model()
    parameters, state, V = nominal(model, friction_floor=0.3, friction_pusher=0.3), push_start(model), straight_push(40)
    whole = Stepper(model).rollout(parameters, state, V)
    for step in range(40):
        after = Stepper(model).step(parameters, whole.frame(step), V[step])
        for name in State.__dataclass_fields__:
            assert torch.equal(getattr(after, name), getattr(whole.frame(step + 1), name))
