import numpy as np
import pytest
import torch
from pydrake.solvers import MathematicalProgram, MobyLcpSolver

from pinwm_drake.physics import Parameters, State, Stepper
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.lcp import solve_on_active_set
from pinwm_drake.physics.reference import build_lcp, solve_lcp
from tests.physics.scenes import nominal, push_model, push_start, random_quaternion, straight_push


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
    parameters = nominal(model, friction_floor=0.5, friction_pusher=0.3, num_worlds=40)
    return model, parameters, random_worlds(model, 40, seed=7), straight_push(1, 40)[0]


def test_residuals_signs_and_complementarity_hold_to_1e_9(problem):
    model, parameters, state, V_WP = problem
    touched = 0
    for world in range(state.num_worlds):
        report = inspect(model, parameters, state, V_WP, world=world)
        touched += int((report.multipliers[:, 0] > 0.0).any())
        assert report.momentum_residual <= 1e-9
        assert report.sign_violation <= 1e-9
        assert report.complementarity <= 1e-9
    assert touched >= 30  # the scenes really are in contact


def test_a_push_stays_solved_to_1e_9():
    model = push_model()
    parameters, state = nominal(model, friction_floor=0.03, friction_pusher=0.03), push_start(model)
    stepper, V = Stepper(model), straight_push(200)
    for t in range(200):
        report = inspect(model, parameters, state, V[t])
        assert max(report.momentum_residual, report.sign_violation, report.complementarity) <= 1e-9
        state = stepper.step(parameters, state, V[t])


def test_drakes_moby_solver_finds_the_same_velocities(problem):
    model, parameters, state, V_WP = problem
    lcp, _, _, _ = build_lcp(model, parameters, state, V_WP)
    matrix, vector = (x.numpy() for x in lcp.standard_form())
    ours = Stepper(model).step(parameters, state, V_WP).V_WB.flatten(1).numpy()
    solved = 0
    for world in range(state.num_worlds):
        program = MathematicalProgram()
        z = program.NewContinuousVariables(len(vector[world]))
        program.AddLinearComplementarityConstraint(matrix[world], vector[world], z)
        result = MobyLcpSolver().Solve(program)
        if not result.is_success():
            continue
        z_moby = result.GetSolution(z)
        slack = matrix[world] @ z_moby + vector[world]
        if min(z_moby.min(), slack.min()) < -1e-8 or np.abs(z_moby * slack).max() > 1e-8:
            continue  # Moby's own pivoting lost its way; its answer is no oracle then
        solved += 1
        right = lcp.p[world] + lcp.H[world].mT @ torch.from_numpy(z_moby)
        theirs = torch.linalg.solve(lcp.A[world], right).numpy()
        # Moby accepts residuals of about 1e-8; divided by the smallest inertia / lever (0.002 kg m), 1e-5.
        np.testing.assert_allclose(ours[world], theirs, rtol=1e-5, atol=1e-5)
    assert solved >= 30


def many_contact_step():
    """A block that slides and spins under the pusher: all floor contacts slip in different directions."""
    model = push_model()
    state = push_start(model)
    state = State(
        state.q_WB,
        state.p_WB,
        torch.tensor([[[0.0, 0.0, 2.0, 0.05, 0.12, 0.0]]], dtype=torch.float64),
        state.q_WP,
        torch.tensor([[0.02, -0.0632, 0.02]], dtype=torch.float64),
    )
    return model, nominal(model, friction_floor=0.4, friction_pusher=0.3), state, straight_push(1)[0]


def test_friction_derivatives_need_the_transposed_system():
    model, parameters, state, V_WP = many_contact_step()
    floor = model.pair_names.index("t_block-floor")
    report = inspect(model, parameters, state, V_WP)
    sliding = (report.multipliers[:, -1] > 1e-6) & (report.multipliers[:, 0] > 0.0)
    assert sliding.sum() >= 6

    weights = torch.tensor([0.3, -0.2, 1.0, 0.5, -0.7, 0.1], dtype=torch.float64)

    def loss(friction):
        theta = Parameters(parameters.mass, parameters.inertia, friction, parameters.restitution)
        return (Stepper(model).step(theta, state, V_WP).V_WB[0, 0] * weights).sum()

    friction = parameters.friction.clone().requires_grad_()
    loss(friction).backward()
    ours = float(friction.grad[0, floor])
    step = 1e-6
    delta = torch.zeros_like(parameters.friction)
    delta[0, floor] = step
    difference = float(loss(parameters.friction + delta) - loss(parameters.friction - delta)) / (2 * step)
    assert ours == pytest.approx(difference, rel=1e-6)

    # The same adjoint with the KKT matrix itself in place of its transpose, as in PIN-WM's released code.
    lcp, contacts, _, free = build_lcp(model, parameters, state, V_WP)
    k = model.friction_directions
    _, z, active = solve_lcp(lcp, free, k)
    on = active[0].to(torch.float64)[:, None]
    bottom = torch.cat([on * lcp.H[0], on * lcp.B[0] + torch.diag(1.0 - on[:, 0])], -1)
    kkt = torch.cat([torch.cat([lcp.A[0], -lcp.H[0].mT], -1), bottom])
    right = torch.cat([weights, torch.zeros(len(kkt) - 6, dtype=torch.float64)])
    value = {}
    for name, matrix in (("transposed", kkt.mT), ("untransposed", kkt)):
        y = torch.linalg.solve(matrix, right)[6:].reshape(-1, k + 2)
        on_floor = contacts.pair[0] == floor
        value[name] = -float((y[:, k + 1] * z[0].reshape(-1, k + 2)[:, 0])[on_floor].sum())
    assert value["transposed"] == pytest.approx(difference, rel=1e-6)
    # The row scaling of an untransposed solve is arbitrary; it is off by far more than rounding.
    assert abs(value["untransposed"] / difference - 1.0) > 0.1


def test_the_reference_active_set_solution_satisfies_its_lcp(problem):
    model, parameters, state, V_WP = problem
    lcp, _, _, free = build_lcp(model, parameters, state, V_WP)
    x, z, active = solve_lcp(lcp, free, model.friction_directions)
    s = lcp.slack(x, z)
    normal = torch.zeros(model.friction_directions + 2, dtype=torch.bool)
    normal[0] = True
    closed = (z.unflatten(-1, (-1, len(normal)))[..., :1] > 0.0) | normal
    s = torch.where(closed.flatten(-2), s, torch.zeros_like(s))
    assert float(s.min()) > -1e-9
    assert float(z.min()) > -1e-9
    assert float((s * z).abs().max()) < 1e-9
    again, _ = solve_on_active_set(lcp, active)
    assert torch.equal(again, x)
