classdef utils < handle
%UTILS  Adds CRTK methods to an object of yours, a la carte.
%
%   classdef force_sensor < dynamicprops
%       properties (Access = protected)
%           crtk_utils
%       end
%       methods
%           function self = force_sensor(ros_namespace, ral)
%               self.crtk_utils = crtk.utils(self, ros_namespace, ral);
%               self.crtk_utils.add_measured_cf();
%           end
%       end
%   end
%
%   utils(class_instance, ros_namespace, ral) finds the device, which takes up to ral.connect_timeout. Without a ral it
%   makes one of its own. A fourth argument is the object whose operating state tells when moves end, for
%   a device below the namespace of that one and without an operating state: a jaw or a gripper.
%
%   Each method add_NAME adds the property NAME, a function handle. It raises crtk:NotOffered if the device
%   has no such feature, and names those that it has.

    properties (SetAccess = private)
        class_instance
        ros_namespace
        ral
    end

    properties (Access = private)
        device = [];      % number by which the Python client knows it
        owns_ral = false;
    end

    methods

        function self = utils(class_instance, ros_namespace, ral, operating_state_instance)
            narginchk(2, 4);
            self.class_instance = class_instance;
            self.ros_namespace = char(ros_namespace);
            if nargin == 2
                ral = crtk.ral('crtk_matlab');
                self.owns_ral = true;
            end
            self.ral = ral;
            request = struct('do', 'device', 'ral', ral.number, ...
                'namespace', self.ros_namespace, 'timeout', ral.connect_timeout);
            if nargin == 4
                if ~isprop(operating_state_instance, 'crtk_device')
                    error('crtk:Input', ['%s: the object whose operating state tells when moves ' ...
                        'end has none. Call its add_operating_state first.'], self.ros_namespace);
                end
                request.parent = operating_state_instance.crtk_device;
            end
            self.device = crtk.internal.call(request);
        end

        function delete(self)
            if ~isempty(self.device)
                crtk.internal.call(struct('do', 'close_device', 'device', self.device));
            end
            if self.owns_ral
                delete(self.ral);
            end
        end

        function add(self, name)
        %ADD  Add the methods of a CRTK name, which may carry a sub-namespace: 'local/measured_cp' is added
        %   as local_measured_cp.
            name = char(name);
            methods_of = crtk.internal.call(struct('do', 'add', 'device', self.device, 'name', name));
            for k = 1:numel(methods_of)
                self.bind(methods_of(k).name, methods_of(k).kind);
            end
        end

        function add_operating_state(self)
        %ADD_OPERATING_STATE  Add operating_state, is_enabled, is_homed, is_busy, state_command, enable,
        %   disable, pause, resume, home, unhome, wait_for_operating_state, wait_for_busy and events.
            self.add('operating_state');
            self.set_property('crtk_device', self.device);
        end

        function add_state_command(self)
        %ADD_STATE_COMMAND  It comes with the operating state.
            self.add_operating_state();
        end

        function add_measured_js(self), self.add('measured_js'); end
        function add_measured_cp(self), self.add('measured_cp'); end
        function add_measured_cv(self), self.add('measured_cv'); end
        function add_measured_cf(self), self.add('measured_cf'); end
        function add_measured_cp_array(self), self.add('measured_cp_array'); end
        function add_setpoint_js(self), self.add('setpoint_js'); end
        function add_setpoint_cp(self), self.add('setpoint_cp'); end
        function add_setpoint_cv(self), self.add('setpoint_cv'); end
        function add_setpoint_cf(self), self.add('setpoint_cf'); end
        function add_goal_js(self), self.add('goal_js'); end
        function add_goal_cp(self), self.add('goal_cp'); end
        function add_goal_cv(self), self.add('goal_cv'); end
        function add_servo_jp(self), self.add('servo_jp'); end
        function add_servo_jr(self), self.add('servo_jr'); end
        function add_servo_jv(self), self.add('servo_jv'); end
        function add_servo_jf(self), self.add('servo_jf'); end
        function add_servo_js(self), self.add('servo_js'); end
        function add_servo_cp(self), self.add('servo_cp'); end
        function add_servo_cr(self), self.add('servo_cr'); end
        function add_servo_cv(self), self.add('servo_cv'); end
        function add_servo_cf(self), self.add('servo_cf'); end
        function add_servo_cs(self), self.add('servo_cs'); end
        function add_interpolate_jp(self), self.add('interpolate_jp'); end
        function add_interpolate_jr(self), self.add('interpolate_jr'); end
        function add_interpolate_jv(self), self.add('interpolate_jv'); end
        function add_interpolate_jf(self), self.add('interpolate_jf'); end
        function add_interpolate_cp(self), self.add('interpolate_cp'); end
        function add_interpolate_cr(self), self.add('interpolate_cr'); end
        function add_interpolate_cv(self), self.add('interpolate_cv'); end
        function add_interpolate_cf(self), self.add('interpolate_cf'); end
        function add_move_jp(self), self.add('move_jp'); end
        function add_move_jr(self), self.add('move_jr'); end
        function add_move_cp(self), self.add('move_cp'); end
        function add_move_cr(self), self.add('move_cr'); end
        function add_hold(self), self.add('hold'); end
        function add_free(self), self.add('free'); end
        function add_use_gravity_compensation(self), self.add('use_gravity_compensation'); end
        function add_body_set_cf_orientation_absolute(self), self.add('body/set_cf_orientation_absolute'); end
        function add_trajectory_j_set_ratio(self), self.add('trajectory_j/set_ratio'); end
        function add_trajectory_j_set_ratio_v(self), self.add('trajectory_j/set_ratio_v'); end
        function add_trajectory_j_set_ratio_a(self), self.add('trajectory_j/set_ratio_a'); end
        function add_trajectory_j_ratio(self), self.add('trajectory_j/ratio'); end
        function add_trajectory_j_ratio_v(self), self.add('trajectory_j/ratio_v'); end
        function add_trajectory_j_ratio_a(self), self.add('trajectory_j/ratio_a'); end
        function add_jacobian(self), self.add('jacobian'); end
        function add_forward_kinematics(self), self.add('forward_kinematics'); end
        function add_inverse_kinematics(self), self.add('inverse_kinematics'); end

    end

    methods (Access = private)

        function bind(self, name, kind)
            device = self.device;
            switch kind
                case 'feedback'
                    method = @(varargin) crtk.internal.feedback(device, name, varargin{:});
                case 'command'
                    method = @(varargin) crtk.internal.command(device, name, varargin{:});
                case 'query'
                    method = @(varargin) crtk.internal.query(device, name, varargin{:});
                case 'state'
                    method = @(varargin) crtk.internal.state(device, name, varargin{:});
            end
            self.set_property(strrep(name, '/', '_'), method);
        end

        function set_property(self, name, value)
            if ~isprop(self.class_instance, name)
                self.class_instance.addprop(name);
            elseif ~isempty(self.class_instance.(name))
                error('crtk:Exists', '%s already exists: it was added before.', name);
            end
            self.class_instance.(name) = value;
        end

    end

end
