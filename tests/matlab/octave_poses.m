function octave_poses()
%OCTAVE_POSES  Poses there and back, over a six-axis arm: matrix, quaternion, message and again.

    ral = crtk.ral('octave_poses');
    r = device_under_test(getenv('CRTK_NAMESPACE'), ral, {'measured_js', 'measured_cp', ...
        'setpoint_js', 'setpoint_cp', 'move_jp', 'move_cp', 'forward_kinematics', ...
        'inverse_kinematics'});
    r.enable(60.0);
    home = [0; -1.3; 1.4; -1.6; -1.57; 0];
    check(r.move_jp(home).wait(false, 60.0), 'the move did not end');

    axes = {[1; 0; 0], [0; 1; 0], [0; 0; 1], [1; 1; 0], [0; 1; 1], [1; 0; 1], [1; 1; 1], ...
        [-1; 2; 3]};
    for angle = [0.0, 1e-9, 1.0, pi - 1e-9, pi, -pi, -2.5]
        for k = 1:numel(axes)
            pose = [rotation(axes{k}, angle), [-0.4; 0.15; 0.3]; 0 0 0 1];
            what = sprintf('%g about %s', angle, mat2str(axes{k}'));
            jp = r.inverse_kinematics(pose, home);
            check(isequal(size(jp), [6 1]), 'joints of size %s', mat2str(size(jp)));
            check_near(r.forward_kinematics(jp), pose, 1e-8, what);
        end
    end

    % position and quaternion x, y, z, w mean the same
    quaternion = [-0.4 0.15 0.3 1 0 0 0];
    jp = r.inverse_kinematics(quaternion, home);
    check_near(r.forward_kinematics(jp), ...
        [diag([1 -1 -1]), [-0.4; 0.15; 0.3]; 0 0 0 1], 1e-8, 'a quaternion');

    % a tool that points straight down is a turn by pi
    down = r.setpoint_cp('wait', 60.0);
    down(1:3, 1:3) = diag([1 -1 -1]);
    down(3, 4) = down(3, 4) + 0.05;
    check(r.move_cp(down).wait(false, 60.0), 'move_cp did not end');
    check_near(r.setpoint_cp('wait', 60.0), down, 1e-4, 'setpoint_cp');
    check_until(@() max(max(abs(r.measured_cp() - down))) < 1e-3, 'it is there');
    ral.shutdown();
end

function matrix = rotation(axis, angle)
%ROTATION  Rodrigues' formula.
    axis = axis / norm(axis);
    cross = [0, -axis(3), axis(2); axis(3), 0, -axis(1); -axis(2), axis(1), 0];
    matrix = eye(3) + sin(angle) * cross + (1.0 - cos(angle)) * cross * cross;
end
