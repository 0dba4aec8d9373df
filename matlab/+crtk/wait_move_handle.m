classdef wait_move_handle
%WAIT_MOVE_HANDLE  A move that was accepted, as move_jp and the like return it.
%
%   r.move_jp(goal).wait();
%   handle = r.move_jp(goal); while handle.is_busy(), ... end

    properties (SetAccess = private)
        number
    end

    methods

        function self = wait_move_handle(number)
            self.number = number;
        end

        function result = wait(self, is_busy, timeout)
        %WAIT  Wait until the move has ended or, with wait(true), until it has begun.
        %   False after timeout seconds; without one it waits as long as the device moves.
        %   Raises crtk:MotionAborted if it ended elsewhere than at its goal.
            if nargin < 2
                is_busy = false;
            end
            request = struct('do', 'wait', 'move', self.number, 'is_busy', logical(is_busy));
            if nargin == 3 && isfinite(timeout)
                request.timeout = timeout;
            end
            result = crtk.internal.call(request);
        end

        function result = is_busy(self)
        %IS_BUSY  Whether the move has not ended.
            result = crtk.internal.call(struct('do', 'is_busy', 'move', self.number));
        end

    end

end
