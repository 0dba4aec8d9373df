classdef ral < handle
%RAL  The ROS Abstraction Layer: the client's side of ROS.
%
%   ral = crtk.ral('node_name');
%   arm = crtk_arm('ur5', ral);      % a class of yours that crtk.utils populates
%   ral.check_connections();
%   ral.shutdown();

    properties (SetAccess = private)
        name    % of the node
        number  % by which the Python client knows it
    end

    properties
        connect_timeout = 10.0  % seconds in which crtk.utils must find its device
    end

    methods

        function self = ral(name)
            self.name = char(name);
            self.number = crtk.internal.call(struct('do', 'ral', 'name', self.name));
        end

        function delete(self)
            if ~isempty(self.number)
                self.shutdown();
            end
        end

        function check_connections(self, timeout)
        %CHECK_CONNECTIONS  Wait, 5 s unless told otherwise, until every topic and service in use has met
        %   its other end. Raises crtk:ConnectionFailed and names those that have not.
            if nargin < 2
                timeout = 5.0;
            end
            crtk.internal.call(struct('do', 'check_connections', 'ral', self.number, ...
                'timeout', timeout));
        end

        function r = rate(~, frequency)
        %RATE  What keeps a loop at a rate in Hz, see crtk.rate.
            r = crtk.rate(frequency);
        end

        function seconds = now(~)
        %NOW  Seconds since 1970, by the clock of this computer; stamps are of the device's.
            seconds = crtk.internal.call(struct('do', 'now'));
        end

        function spin(~)
        %SPIN  Nothing: messages arrive from the beginning. For scripts that come from Python.
        end

        function spin_and_execute(self, f, varargin)
        %SPIN_AND_EXECUTE  Call f with the arguments that follow, then shut down, also after an error.
            cleanup = onCleanup(@() self.shutdown());
            f(varargin{:});
        end

        function shutdown(self)
        %SHUTDOWN  Leave ROS. The devices go on as they are. May be called twice.
            crtk.internal.call(struct('do', 'shutdown', 'ral', self.number));
        end

        function result = is_shutdown(self)
        %IS_SHUTDOWN  Whether shutdown was called.
            result = crtk.internal.call(struct('do', 'is_shutdown', 'ral', self.number));
        end

    end

end
